"""`python -m virtual_bus`: the simulated drive as a process."""

import sys

from virtual_bus.realtime.process import main

sys.exit(main())
