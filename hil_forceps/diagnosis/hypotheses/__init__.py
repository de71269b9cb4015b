"""Which entries of the catalogue explain what the known parameters leave.

places      where to look for each entry: shapes that cover what the runs contain
score_test  what each place would gain, to first order, and what chance gives
shortlist   which entries are refitted, and from which place and shape
search      forward selection with refits, backward elimination, exchange; the models that the data can't tell apart
"""
