"""The closed loop of a batch as one native kernel, made from the program that JAX traces: no physics is written twice.

`trace` has JAX trace a rollout's tick. `interpret` goes through that, by `rules` for JAX's primitives, of which `maths`
and `randomness` write some in simpler ones; `arrays` takes them apart into operations on single numbers, which
`operations` simplifies and `program` keeps free of repetition.

What is run too seldom to be compiled goes through NumPy: `eager`, by `eager_rules` and `batch_ops`.

For a CPU `schedule` says what goes leg by leg, `llvm` prints and compiles it with rollouts in vector lanes, and
`kernel` runs batches through it. For a GPU `lanes` puts it in order and in parts, `cuda` prints these with legs in the
lanes of a warp or with a rollout in each thread, `nvptx` compiles them, and `launch` runs them in a program of XLA's.
"""
