"""Whether a model leaves anything: curves without physics in them, over many variables, at every place.

curves         the families: where they act, over which variable
omnibus_test   all families of curves scored at once, with one false-alarm rate
"""
