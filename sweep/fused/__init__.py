"""The fused compiler: compiles the program that JAX traces for one rollout into one native kernel for a batch.

`trace` lets JAX trace a rollout's tick. `interpret` applies a rule for each of JAX's primitives (`rules`); `maths` and
`randomness` expand some of them into simpler ones. `arrays` takes them apart into operations on single numbers, which
`operations` simplifies and `program` stores without repetition.

Programs that run too seldom to be compiled are executed by NumPy: `eager`, with `eager_rules` and `batch_ops`.

For a CPU, `schedule` decides what is computed leg by leg, `llvm` prints and compiles the program with rollouts in
vector lanes, and `kernel` runs batches through it. For a GPU, `lanes` orders the program and splits it into parts,
`cuda` prints them with legs in the lanes of a warp or with a rollout in each thread, `nvptx` compiles them, and
`launch` runs them inside an XLA program.
"""
