"""Which entries of the catalogue explain what the known parameters leave.

entries     shapes and sizes of each entry that cover what the runs contain
places      these as directions and waves beside a model
harmonics   which harmonics to look at where they need not be whole
score_test  what each place would gain, to first order, and what chance gives
shortlist   which entries are refitted, and from which place and shape
search      forward selection with refits, backward elimination, exchange; the models that the data can't tell apart
"""
