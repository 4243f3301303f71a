"""Checks of a plan, one module a subject: functions from scene, bench and plan to results with text and remedy.

    check_result      one result, and the error that refuses a plan
    simulation        settings of the twin against those of scene and bench
    tracking          whether the twin's echoes and motion can be tracked
    excitation        tonebursts against limits, pulses and gates; tasks of the generators; drive of the transducers
    identity          generators of a real bench known by serial number, its cables proven
    acoustic_output   estimated output at the focus against its limits
    timing            periods, record and depth; accuracies of the clocks
    sampling          aliasing, window, resolution and size of the fit
    digitizer         records against the limits of the board
    depth_gates       gates over depth: in the record, undisturbed, with echoes
    checklist         every check in order

The limits of instruments are those of `drivers`, so that a plan that passes is one that the instruments accept.
"""
