"""The catalogue of effects: one file each, with its entry and its equations as plain functions.

The model is composed of them (`model.composition`). The simulated world has equations of its own.
"""
