"""Models held against measured runs: simulated beside them, or fitted and compared in runs that were left out."""
