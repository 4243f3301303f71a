"""hpe_rig/validation/accuracy"""
