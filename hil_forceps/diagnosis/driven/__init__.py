"""Runs whose drive isn't known: the motion of the motor as measured drives the model, its torque is what is compared.

rows             channels low-passed and thinned out, rows at rest masked
smoothing        what drives, without its noise
jaw_zero         the zero between both encoders, common to all runs
starting_values  of what the rig doesn't know, by least squares on the balances
simulation       torque or current, and the jaw's angle, from motion and load
passed           runs as the search takes them, and beside models (`evidence.Passed`), zeros of sensors fitted
whitening        the autoregressive filter that makes a channel's noise white
noise            what neither a model nor a regression on the catalogue explains
identification   from rows to the models that the search finds
ladder           what each entry gained, in runs held out
gauge            what no sensor shows: radii and stiffness have a scale in common
conclusion       from runs to the whole result
"""
