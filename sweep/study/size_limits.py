"""Largest size of a study, in a module that is fast to import: checks of stored files need it before anything else."""

MAX_STUDY_ROLLOUTS = 20_000_000  # rollouts of a study, whose plan takes 10 GB
