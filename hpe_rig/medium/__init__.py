"""Physics of the specimen, stated once: material laws, push force, shear field, and the ensemble of likely media.

    material_laws.py   complex shear modulus G(f) of each law
    push_force.py      force f(r, z) of a Gaussian beam or of an aperture
    shear_field.py     displacement U(f, r, z) that the force drives
    ensemble.py        displacement spectra of many media: the statistics behind the medium prior

Processing, prediction and moduli use these; the twin has physics of its own, so that a mistake here shows as a wrong
measurement there.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
