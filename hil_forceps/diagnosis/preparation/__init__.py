"""From a run's columns to what the filter takes of it (`state_space.layout.Series`).

command      what the drive commanded: its law on the recorded angles, or the measured current
load_prior   how much the load may change from row to row: stationary, with breaks of slope and jumps
regimes      where a mass slides for sure, and where it may stick
records      all of it, run by run
"""
