"""Parameters from innovations: priors, the fit, what it leaves open.

parameters      what is fitted: known parameters of the rig with their priors, parameters of effects within their ranges
fit             Gauss-Newton on whitened innovations, the filter's weights and gains taken anew at each step
load_noise      how much the load wanders, by the likelihood of all channels
"""
