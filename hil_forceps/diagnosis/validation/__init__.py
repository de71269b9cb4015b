"""What a model says of runs: simulated in closed loop beside the measurements, and what extending it gains there.

simulation   a run simulated with given parameters from the filter's start, under the load as measured
replicate    a run simulated with a fitted model, with fresh noise
conclusion   from runs to the whole result
verdict      the verdict, its words, named effects and shifts with their intervals
numbers      what the data would show, how balances fail, over what residuals vary
told         models beside the runs, and the result, put together
rows         rows of a run as figures, gains and estimates take them
heldout      what extending a model gains in runs held out
strokes      the noise floor of runs that repeat themselves
estimates    load and jaw angle by the estimators, before and after
"""
