"""The plant as a state-space model with every nuisance a state, filtered along a recorded run.

State (`layout`): both angles and speeds, the load and its slope, dry friction where a mass may stick, errors of the
drive's command, sensors' zeros and coloured noise. The drive's law acts on what was recorded; what it counted between
rows, or in lost ones, is told by the filter.

layout         places of states and measurements, what the filter takes of a run and gives
interval       likelihood of a count
transition     linear part of the transition, covariance of a jump of the load
advance        the model's own step over a row
measurement    what the sensors show, and what a measurement changes
covariance     its way from row to row
drive/         the drive's law, what it counted between rows, and errors of its command
row_*          the parts of a pass: plant, friction and measurements of a row
filter_pass    one pass: innovations, their weights, gains, the course of the state
response_pass  how the innovations answer to other parameters, along that course and with those gains
forcing_pass   how they answer to torques and errors of sensors that are given row by row, many at once
passes         a run as the filter passes over it: what is evidence, and how it answers

Sources: Särkkä and Svensson, Bayesian Filtering and Smoothing (2nd ed., 2023), chapters 7 and 16; R. E. Curry,
Estimation and Control with Quantized Measurements (1970), for counts; Gouriéroux et al., Generalised residuals, J.
Econometrics 34 (1987), for their score.
"""
