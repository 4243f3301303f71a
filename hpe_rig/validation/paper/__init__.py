"""hpe_rig/validation/paper"""
