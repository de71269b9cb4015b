"""The documents as a site: what is written by hand, and the reference out of the program, as pages for a generator."""
