"""Runs whose drive isn't known: the motion of the motor as measured drives the model, its torque is what is compared.

rows       = channels low-passed and thinned out, rows at rest masked
simulation = torque or current, and the jaw's angle, from motion and load
whitening  = autoregressive, of what the model so far leaves
passed     = a run beside a model, as the search takes it (`evidence.Passed`)
"""
