"""Whether a model leaves anything: curves without physics in them, over many variables, at every place.

omnibus_test   all families of curves scored at once, with one false-alarm rate
"""
