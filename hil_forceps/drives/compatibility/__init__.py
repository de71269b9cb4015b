"""Whether settings go together, of one rig and of several on one line; told before anything is connected."""
