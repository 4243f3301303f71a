"""Motion of many lines and depths at once, one pixel per gate.

motion_map.py      samples, or I and Q -> amplitude, phase and velocity of every pixel
pixel_noise.py     noise and decorrelation of a pixel -> variances of its fitted states
kernels.py         phases, residuals and estimates of pixels; kernels_numba.py is the compiled form
"""
