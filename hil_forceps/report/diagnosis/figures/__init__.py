"""The figures of a diagnosis: over time, of residuals, and of the evidence."""
