"""A wire-driven instrument: estimators and black boxes on its runs, fitted to some and judged on others."""
