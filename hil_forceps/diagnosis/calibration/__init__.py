"""Thresholds by a parametric bootstrap, where the filter is only an approximation.

replica    a run as the model beside the known parameters would have given it, with fresh noise
bootstrap  what replicas without any effect seem to show, and what the measured runs have to go beyond
"""
