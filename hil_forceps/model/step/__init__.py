"""Steps of the plant with every effect: exact where it is linear, dry friction by a rule of its own."""
