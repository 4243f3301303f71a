"""Checks of a plan, one file a subject: a function from scene, bench and plan to results with level, text and remedy.

    check_result      one result, and the error that refuses a plan
    simulation        what the twin measures on
    tracking          whether its echoes and motion can be tracked
    excitation        tonebursts against the bench's limits, and against pulses and gates
    output            tasks against what the generators can do
    acoustic_output   estimated output at the focus against its limits
    timing            periods, record and depth
    sampling          aliasing, window, resolution and size of the fit
    digitizer         records against what the board can do
    depth_gates       gates over depth: in the record, clear of tonebursts, where something echoes
    checklist         every check in order

What instruments can do is asked of `drivers`, so that a plan that passes is one that they accept.
"""
