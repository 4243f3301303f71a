"""hpe_rig/plan/checks"""
