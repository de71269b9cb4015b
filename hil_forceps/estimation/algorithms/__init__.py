"""One file for each algorithm; its estimators are listed in `ALGORITHMS`."""
