"""The rig file: parameters with units, and their validation."""
