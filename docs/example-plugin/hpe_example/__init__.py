"""An estimator, a medium and an importer for hpe-rig."""
