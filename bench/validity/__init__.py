"""Scenes with known answers, simulated by this package's physics step, C MuJoCo and MJX: see research/validity.md.

`scenes` defines them and the expected results; `points` prepares them for this package's step, `peers` for MuJoCo, and
`reference` integrates the contact law explicitly at 10 us. `robot` has scenes of the robot itself.
"""
