"""The model that a diagnosis tests: plant, drive and sensors, as scalar step functions."""
