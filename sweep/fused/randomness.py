"""JAX's random numbers to the last bit: Threefry-2x32 with 20 rounds (Salmon et al., 2011) on counters.

A random key is one element of an array of keys: a pair of words.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32

from sweep.fused.arrays import UnsupportedPrimitive

ROTATIONS_BY_ROUND = ((13, 15, 26, 6), (17, 29, 16, 24))
KEY_PARITY = 0x1BD11BDA


def keys_to_words(tree: Any) -> Any:
    """Replace JAX random keys in a tree of arrays or shapes by arrays of their 32-bit words (..., 2)."""

    def one(x: Any) -> Any:
        if not is_key(x):
            return x
        return jax.eval_shape(jax.random.key_data, x) if isinstance(x, jax.ShapeDtypeStruct) else jax.random.key_data(x)

    return jax.tree.map(one, tree)


def rewrap_if_key(x: Any, original: Any) -> Any:
    """Convert 32-bit words back to a JAX random key if `original` is a key; else return the array unchanged."""
    return jax.random.wrap_key_data(x) if is_key(original) else x


def is_key(x: Any) -> bool:
    """Whether an array, or its shape, holds random keys."""
    return not isinstance(x.dtype, np.dtype) and jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def threefry_words(
    key: UInt32[Array, " 2"], first: UInt32[Array, "..."], second: UInt32[Array, "..."]
) -> tuple[Array, Array]:
    """Return two random words for each counter, which has two words, by the generator Threefry-2x32.

    Args:
        key: words of the key.
        first: first words of the counters.
        second: second words.
    """
    words = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(KEY_PARITY))
    a, b = first + words[0], second + words[1]
    for i in range(5):
        for turn in ROTATIONS_BY_ROUND[i % 2]:
            a = a + b
            b = ((b << jnp.uint32(turn)) | (b >> jnp.uint32(32 - turn))) ^ a
        a, b = a + words[(i + 1) % 3], b + words[(i + 2) % 3] + jnp.uint32(i + 1)
    return a, b


def _counted(key: Array, count: int) -> tuple[Array, Array]:
    return threefry_words(key, jnp.zeros(count, jnp.uint32), jnp.arange(count, dtype=jnp.uint32))


def fold_in(key: Array, number: Array) -> Array:
    """Fold an integer into a random key, as `jax.random.fold_in`, and return the words of the new key."""
    return jnp.stack(threefry_words(key, jnp.uint32(0), number.astype(jnp.uint32)))


def random_bits(key: Array, shape: tuple[int, ...]) -> Array:
    """Return random 32-bit words, bit for bit those of JAX."""
    a, b = _counted(key, int(np.prod(shape)))
    return (a ^ b).reshape(shape)


def random_64_bit_words(key: Array, shape: tuple[int, ...]) -> Array:
    """Return random 64-bit words, bit for bit those of JAX."""
    a, b = _counted(key, int(np.prod(shape)))
    return ((a.astype(jnp.uint64) << jnp.uint64(32)) | b.astype(jnp.uint64)).reshape(shape)


def split_key(key: Array, shape: tuple[int, ...]) -> Array:
    """Return the words (*shape, 2) of new keys split from a key, as `jax.random.split`."""
    return jnp.stack(_counted(key, int(np.prod(shape))), axis=-1).reshape((*shape, 2))


def _bits(key: Array, bit_width: int, shape: tuple[int, ...]) -> Array:
    if bit_width not in (32, 64):
        raise UnsupportedPrimitive(f"random words of {bit_width} bits")
    return random_bits(key, shape) if bit_width == 32 else random_64_bit_words(key, shape)


# functions of a key's words, other operands and JAX's parameters; keys are returned as words
EXPANSIONS: dict[str, Callable[..., Array]] = {
    "random_bits": _bits,
    "random_split": split_key,
    "random_fold_in": fold_in,
}


def random_primitive_rules() -> dict[str, Callable]:
    """Return the interpreter's rules for random primitives on scalar keys."""

    def written(function: Callable) -> Callable:
        def rule(self: Any, keys: np.ndarray, *args: np.ndarray, out: Any, **params: Any) -> np.ndarray:
            if keys.shape:
                raise UnsupportedPrimitive("random numbers of several keys at once")
            if params.get("bit_width", 32) != 32:
                raise UnsupportedPrimitive(f"random words of {params['bit_width']} bits")
            made = self.expand_primitive_by_tracing(
                lambda *xs: function(*xs, **params), [_words(keys), *args], ["uint32", *["uint32"] * len(args)]
            )
            return _pairs(made) if is_key(out) else made

        return rule

    return {
        "random_wrap": lambda self, x, out, **_: _pairs(x),
        "random_unwrap": lambda self, x, out, **_: _words(x),
        **{name: written(function) for name, function in EXPANSIONS.items()},
    }


def _pairs(words: np.ndarray) -> np.ndarray:
    keys = np.empty(words.shape[:-1], object)
    for at in np.ndindex(keys.shape):
        keys[at] = tuple(words[at])
    return keys


def _words(keys: np.ndarray) -> np.ndarray:
    words = np.empty((*keys.shape, 2), object)
    for at in np.ndindex(keys.shape):
        words[at] = keys[at]
    return words
