"""Scenes with known answers, through this package's physics step, C MuJoCo and MJX: see research/validity.md.

`scenes` says what they are and what must come out; `points` puts them before the step, `peers` before MuJoCo, and
`reference` is a plain integration of the contact law at 10 us. `robot` has scenes of the robot itself.
"""
