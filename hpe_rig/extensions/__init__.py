"""Extensions: estimators, media and importers that other packages add by entry points.

    entry_points.py   the installed extensions of a group; one loaded by its name; a failure names its package

    group                  object at the entry point                               used by
    hpe_rig.estimators     ``processing.EstimatorSpec``                            scene, processing
    hpe_rig.media          ``moduli.Law``; the twin moves by it too               moduli, sim_backend
    hpe_rig.importers      ``recordings.Importer``                                 recordings
    hpe_rig.conditions     a function that returns a number                        bench

Names are listed without importing anything; a package is imported when its name is used. Built-in names cannot be
replaced. The page docs/how-to/extend.md has a worked example.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
