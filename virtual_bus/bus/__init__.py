"""The bus in virtual time: arbitration, bit times, faults, nodes."""
