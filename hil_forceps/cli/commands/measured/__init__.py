"""Commands about measured runs, and models held against them."""
