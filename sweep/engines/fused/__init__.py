"""The closed loop of a batch as one native kernel, made from the program that JAX traces: no physics is written twice.

`interpret` takes JAX's program of a rollout apart into operations on single numbers, `program` keeps them free of
repetition, `schedule` says what is worked out leg by leg, `llvm` prints and compiles it with rollouts in vector lanes,
and `kernel` runs batches through it.
"""
