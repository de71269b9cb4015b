"""A diagnosis as a page, figures and words."""
