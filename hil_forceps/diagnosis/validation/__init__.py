"""What a model says of runs: simulated in closed loop beside the measurements, and what extending it gains there.

simulation   a run simulated with given parameters from the filter's start, under the load as measured
conclusion   from runs to the whole result
verdict      the verdict, its words, and every number of the result
"""
