"""Known parameters of instruments over many sessions: the fit of one session, and changes from session to session.

session_fit   the known parameters of one session, without the catalogue of effects
likelihood    estimates by a session's likelihood alone, the rig's values taken out again
scatter       the covariance of estimates without drift: each session's own error, and a scatter from session to session
regression    the likelihood of a level with steps, bends and single outlying sessions, over all scatters at once
change_test   the likelihood ratio over all changes, and what it reaches by chance (a parametric bootstrap)
onset         where a change began, with its interval
outliers      single sessions that lie apart from the others
series        one parameter: changes one by one, the course with its interval
family        all parameters of an instrument under one rate of false alarms
result        what was found, as plain data; words: parameters and usual causes in words
"""
