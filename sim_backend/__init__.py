"""Digital twin of the bench: programmed registers -> digitizer codes, with each equation of the paper in one module.

    SCPI text, ATSApi calls -> registers                       transports/, generator/, digitizer/
    registers -> edges -> bursts, integer picoseconds          world.py, wiring.py
    bursts -> volts at the digitizer's input                   acoustics/
      f(t), F(f)        toneburst train, its force   (17) (18) motion/: force.py
      A(k t_s)          prescribed motion            (1) (13)  motion/: prescribed.py
      u at the focus    of a viscoelastic medium               motion/: specimen.py, inverse_laplace.py
      u off the focus   Gaussian                     (12)      echoes/: scatterers.py
                        or the medium's own field              motion/: field.py
      t_k,n             delay of a scatterer's echo  (11)      echoes/: delays.py
      I(x, y, z)        tracking beam                (8)       echoes/: scatterers.py
      w(t) cos(w_f t)   echo pulse                   (9)       echoes/: pulse.py
      r_k(t)            sum over scatterers          (7) (10)  echoes/: engine.py
      I(x, y, z)        of a real transducer                   transducer/: radiation.py
      n_k(t)            noise                        (16)      receiver/: front_end.py
      receive chain, trigger jitter                  III.B     receiver/: chain.py, timing.py
    volts -> codes at the ticks of the sample clock            digitizer/
    [simulation] of a scene                                    settings/
    types of arrays                                            arrays.py

Its interface is the wire: SCPI text for the generators, the ATSApi function table for the digitizer. It receives only
the drivers' commands, never the scene. Theory beyond the paper: docs/explanation/, medium.md, echoes.md, transducer.md.
"""
