"""The truth plant without effects: motor, wire, jaw, load, sensors and the drive's position loop."""
