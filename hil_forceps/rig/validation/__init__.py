"""What is wrong in a rig file: checks between its keys, and each problem as a line for the user."""
