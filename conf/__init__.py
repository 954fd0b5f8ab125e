"""Hydra configuration groups, one file for one choice; its first comment line describes it in `sweep list`."""
