"""Control and acquisition for a harmonic pulsed excitation ultrasound bench; this is the map.

scene.toml -> plan -> bench -> sequencer -> records -> processing -> result
scene.py      plan.py  bench.py  sequencer.py  store.py   estimation.py  result.py        all of it: run.py

what                                        equation of the paper          where
burst train, spectrum of its force          (17), (18)                     theory.py, sim_backend/motion/force.py
displacement D(t), velocity                 (1), (2)                       processing/harmonic.py
echo of a scatterer, its delay              (3), (7) to (13)               sim_backend/echoes/engine.py
cross-spectrum, velocity from its phase     (5), (6)                       processing/motion.py
amplitude and phase from displacement       Kalman filter, least squares   processing/harmonic.py
noise at a signal-to-noise ratio            (16)                           sim_backend/receiver/front_end.py

T_b  burst_length_s     f_r  burst_rate_hz     f_prf  pulse_rate_hz     t_d  tracking.delay_s
l_g  gate_length_m      F_s  sample_rate_hz    f_v    frequencies_hz    T_s  processing.window_length_s
E, T excitation_width_m, tracking_width_m      D_0, phi_s  amplitude_m, phase_rad
"""
