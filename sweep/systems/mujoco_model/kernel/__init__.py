"""MuJoCo's physics step of a legged robot, written out over its limbs, as one kernel of the fused compiler.

`layout` reads which bodies are alike, `scalars` has numbers that fold constants, `numbers` reads them from a model or
from a rollout's own values, `smooth` has kinematics and inertia, `constraints` contacts, limits and friction of joints,
`links`, `tendons` and `link_constraints` tendons and equality constraints, `solver` Newton's method, `step` the
integrator, `sensors` what policies read.
"""
