"""Which experiment to make next, by what the filter would see of it.

menu              motions that the rig's limits allow
next_experiment   the experiment of the menu that tells rivals apart best, or shows what the runs show least
"""
