"""One file or folder for each format that a run may be stored in; `read_run` tells which one a file has."""
