"""Accuracy: error against run time of every stage and end to end.

`work_precision` times and draws; `specimen`, `echo` and `chain` measure the twin's physics, `motion` and `harmonic` the
estimators, `end_to_end` all of it and `extremes` stiff cases of every stage; `report` puts them on a page. `own_scene`
measures the choices that a scene leaves open on that scene.
"""
