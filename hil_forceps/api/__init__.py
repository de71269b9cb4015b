"""What Python programs call, and the commands of the command line too: few functions over the packages below."""
