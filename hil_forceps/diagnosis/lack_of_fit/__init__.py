"""Whether a model leaves anything: curves without physics in them, over many variables, at every place.

forcing_pass   how the innovations answer to torques and errors of sensors that are given row by row
omnibus_test   all families of curves scored at once, with one false-alarm rate
"""
