"""The closed loop of a batch as one native kernel, made from the program that JAX traces: no physics is written twice.

`trace` has JAX trace a rollout's tick, `interpret` takes that apart into operations on single numbers, and `program`
keeps them free of repetition. For a CPU `schedule` says what is worked out leg by leg, `llvm` prints and compiles it
with rollouts in vector lanes, and `kernel` runs batches through it. For a GPU `lanes` puts it in order, `cuda`
prints it with legs in the lanes of a warp, `nvptx` compiles it, and `launch` runs it within a program of XLA's.
"""
