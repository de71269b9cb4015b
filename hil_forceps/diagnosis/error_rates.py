"""Error rates that a diagnosis is made with; texts of the report quote them from here."""

FALSE_ALARMS = 0.005  # share of data sets without any effect in which the whole catalogue together names one
DETECTION_POWER = 0.8  # share of data sets in which an effect of the least detectable size is found
STEP_ACCURACY = 1e-3  # relative error of an effect's amplitude by the simulation's steps
# Share of the explained χ² that such an error can make: a gain below it names no effect and refutes none.
STEP_ERROR_SHARE = STEP_ACCURACY**2
# The same of runs that are driven by their motion, and of such that were held out: no loop keeps errors small there.
UNEXPLAINED_SHARE_DRIVEN = 0.1  # tuned: two jaws of an instrument
UNSEEN_SHARE_DRIVEN = 0.6  # tuned: an axis whose second file has another zero
SETS_WITHOUT_TRUTH = 0.05  # share of data sets whose set of models doesn't hold the true one, at most
