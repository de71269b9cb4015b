"""One file for each algorithm; those that it offers are its `ALGORITHMS`."""
