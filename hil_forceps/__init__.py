"""Bridge and bench for wire-actuated surgical forceps. Not a medical device."""

__version__ = "0.1.0"
