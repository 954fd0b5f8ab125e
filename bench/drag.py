"""Duration of a million drag integrals: `python bench/drag.py`."""

import time

import jax
import numpy as np

from sweep.formulas.drag import drag_integrals

MANY = 1_000_000


def main() -> None:
    """Print the shortest of three runs after compilation."""
    c, al, be = np.random.default_rng(0).normal(size=(3, MANY)).astype(np.float32)
    batch = jax.jit(jax.vmap(drag_integrals, in_axes=(0, 0, 0, None, None)))
    durations = []
    for _ in range(4):
        start = time.perf_counter()
        jax.block_until_ready(batch(c, al, be, 1.0, 0.5))
        durations.append(time.perf_counter() - start)
    print(f"{MANY} drag integrals: {min(durations[1:]):.2f} s on {jax.devices()[0].device_kind}")


if __name__ == "__main__":
    main()
