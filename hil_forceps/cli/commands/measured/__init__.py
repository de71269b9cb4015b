"""Commands on measured runs and the comparison of models with them."""
