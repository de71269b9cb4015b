"""Drive profiles: what a motor driver speaks, one sans-IO module each, behind the port that the service knows."""
