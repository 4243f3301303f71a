"""Studies: many runs of the twin's physics, and how its error pays for run time."""
