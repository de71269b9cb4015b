"""Simulated motor drivers that speak their makers' protocols, with the forceps behind them."""
