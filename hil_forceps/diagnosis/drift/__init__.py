"""Drift of a parameter over sessions: its course, its scatter between sessions, and when it began to change.

scatter       the covariance of estimates without drift: each session's own error, and a scatter from session to session
regression    the likelihood of a level with steps, bends and single outlying sessions, over all scatters at once
change_test   the likelihood ratio over all changes, and what it reaches by chance (a parametric bootstrap)
onset         where a change began, with its interval
series        one parameter: changes one by one, the course with its interval
family        all parameters of an instrument under one rate of false alarms
"""
