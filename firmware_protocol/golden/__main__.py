"""Write the golden vectors to standard output."""

import sys

from firmware_protocol.golden import document

sys.stdout.write(document())
