"""Error against run time of every stage, and end to end.

`work_precision` times and draws. `specimen`, `echo` and `chain` measure the physics of the twin, `motion` and
`harmonic` the estimators, `end_to_end` all stages together, and `extremes` stiff cases of every stage. `report` writes
them to a page. `own_scene` varies the settings of a given scene.
"""
