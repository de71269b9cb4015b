"""From a run's columns to what the filter takes of it (`state_space.layout.Series`).

excerpts     parts of runs that are too long, spread over them
sensor_noise deviation, correlation and resolution of the sensors' noise
resolution   the step that recorded values come in
command      what is known of the drive: its law, where its integral began, which references it may have followed
contact      whether the load is that of something which the jaw touches
load_prior   how much the load may change from row to row: stationary, with breaks of slope and jumps
regimes      where a mass slides for sure, and where it may stick
records      all of it, run by run
reference_timing  which references a drive follows between rows, from a pass of the filter
"""
