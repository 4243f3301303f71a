"""Control and acquisition for a harmonic pulsed excitation (HPE) ultrasound bench and its twin.

>>> import hpe_rig as hpe
>>> scene = hpe.load_scene("bovine-muscle").with_({"tracking.pulse_rate_hz": 3890.0})
>>> print(hpe.check(scene))
>>> run = hpe.measure(scene, path="muscle.h5")            # on the twin; bench="my-bench.toml" on a real one
>>> run.displacement_m(0)                                # of every tracking pulse, m; run.records[0].codes: echoes
>>> run.estimate("coherent").to_frame()                  # amplitude and phase; .figure(); both in a notebook
>>> hpe.open_run("muscle.h5").estimate("kasai")
>>> hpe.estimate(rf, sample_rate_hz=100e6, pulse_rate_hz=4e3, carrier_hz=9e6, frequencies_hz=[200.0])
>>> hpe.run_study("fig-7", "results")

A scene is given as a name, a path or a ``Scene``. The packages, in the order of the flow:

scene.toml -> plan -> bench -> sequencer -> records -> processing -> result -> report
scene/        plan/   bench/   measurement/ store/     processing/   result/   report/

before a measurement: prediction/, design/; after it: moduli/, runs/; physics of the specimen: medium/
files and code of others: recordings/, extensions/; around the flow: live/, study/, validation/, cli/
arrays.py: types of arrays; queued_file.py: files written by a thread; startup.py: Ctrl-C while the program loads

what                                        equation of the paper          where
burst train, spectrum of its force          (17), (18)                     prediction/, sim_backend/motion
displacement D(t), velocity                 (1), (2)                       processing/harmonics/model.py
echo of a scatterer, its delay              (3), (7) to (13)               sim_backend/echoes
cross-spectrum, velocity from its phase     (5), (6)                       processing/motion/spectral_peak.py
amplitude and phase from displacement       Kalman filter, least squares   processing/harmonics/
noise at a signal-to-noise ratio            (16)                           sim_backend/receiver

T_b  burst_length_s     f_r  burst_rate_hz     f_prf  pulse_rate_hz     t_d  tracking.delay_s
l_g  gate_length_m      F_s  sample_rate_hz    f_v    frequencies_hz    T_s  processing.window_length_s
E, T excitation_width_m, tracking_width_m      D_0, phi_s  amplitude_m, phase_rad
"""

from hpe_rig.startup import exit_on_interrupt, is_program

if is_program():
    # First of all: the imports below take as long as the start of Python.
    exit_on_interrupt()

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
