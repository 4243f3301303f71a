"""Extensions: estimators, media and importers that other packages bring by entry points.

    entry_points.py   what is installed in a group, one loaded by its name; what fails names its package

    group                  object at the entry point                               asked for by
    hpe_rig.estimators     ``processing.EstimatorSpec``                            scene, processing
    hpe_rig.media          ``moduli.Law``; the twin moves by it too               moduli, sim_backend
    hpe_rig.importers      ``recordings.Importer``                                 recordings

Names are read without loading anything; a package is imported when its name is asked for. A name of ours cannot be
taken. The page docs/how-to/extend.md has a worked example.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
