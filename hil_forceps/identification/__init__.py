"""Models fitted to measured runs, and held against runs that were left out."""
