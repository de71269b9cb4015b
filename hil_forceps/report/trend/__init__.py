"""Parameters over sessions, as a page and figures."""
