"""Interpreter of PTX kernels without a GPU: warp by warp in NumPy, whose threads all take the same branches."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np

from sweep.fused import cuda

FLOAT_TESTS = {"eq": "a == b", "ne": "(a != b) & ~odd", "lt": "a < b", "le": "a <= b", "gt": "a > b", "ge": "a >= b",
               "nan": "odd", "num": "~odd"}  # fmt: skip
BINARY = {"add": "a + b", "sub": "a - b", "mul": "a * b", "div": "a / b", "max": "np.maximum(a, b)",
          "min": "np.minimum(a, b)", "and": "a & b", "or": "a | b", "xor": "a ^ b",
          "shl": "np.left_shift(a, b)", "shr": "np.right_shift(a, b)", "rem": "np.fmod(a, b)"}  # fmt: skip
UNARY = {"neg": "-a", "abs": "np.abs(a)", "sqrt": "np.sqrt(a)", "rcp": "one / a", "rsqrt": "one / np.sqrt(a)",
         "not": "~a", "mov": "a"}  # fmt: skip
TYPES = {"f32": "float32", "s32": "int32", "u32": "uint32", "b32": "uint32", "s64": "int64", "u64": "int64",
         "b64": "int64", "b16": "uint32", "u16": "uint32", "s16": "int32", "pred": "bool"}  # fmt: skip
PAGE = 40  # bits of an address within an operand


class Kernel:
    """One kernel of a module."""

    def __init__(self, text: str):
        self.tables = {}
        for k, (name, size, values) in enumerate(re.findall(r"(table\d+)\[(\d+)\] = \{(.*?)\}", text)):
            given = np.zeros(int(size), np.uint8)  # zeros at the end may be left out
            given[: values.count(",") + 1] = [int(v) for v in values.split(",")]
            self.tables[name] = (100 + k, given.view(np.uint32))
        body = text[text.index("{\n", text.index(".entry")) + 2 : text.rindex("}")]
        lines, label, self.blocks, self.stops = [], "entry", {}, 0
        for raw in body.splitlines():
            line = raw.split("//")[0].strip()
            if line.endswith(":"):
                self.blocks[label] = [*lines, f"return '{line[:-1]}'"]
                lines, label = [], line[:-1]
            elif line and not line.startswith("."):
                for one in self._line(line.rstrip(";")):
                    if one.endswith(":"):
                        self.blocks[label], lines, label = lines, [], one[:-1]
                    else:
                        lines.append(one)
        self.blocks[label] = lines
        self.code = {name: self._compiled(name, lines) for name, lines in self.blocks.items()}

    @staticmethod
    def _compiled(name: str, lines: list[str]) -> Any:
        space: dict[str, Any] = {"np": np, "one": np.float32(1), "told": told}
        exec(compile("def block(r, m):\n " + "\n ".join(lines or ["pass"]), f"block {name}", "exec"), space)
        return space["block"]

    def _line(self, line: str) -> list[str]:
        """Python for an instruction."""
        if guard := re.match(r"@(!?)%(\w+)\s+bra(\.uni)?\s+(\S+)", line):
            return [f"if told(r['{guard[2]}']) != {bool(guard[1])}: return '{guard[4]}'"]
        op, _, rest = line.partition(" ")
        name, *kinds = op.strip().split(".")
        args = [x.strip() for x in rest.split(",")]
        if name == "bra":
            return [f"return '{args[0]}'"]
        if name == "ret":
            return ["return None"]
        if name in ("bar", "barrier"):
            if kinds[0] == "warp":
                return []
            self.stops += 1
            return [f"return 'stop {self.stops}'", f"stop {self.stops}:"]
        kind = kinds[-1] if kinds else ""
        if name in ("ld", "st"):
            return self._memory(name, kinds, args)
        if name == "setp":
            return self._test(kinds, args)
        value = self._value(name, kinds, kind, args)
        return [f"r['{args[0][1:]}'] = {value}"]

    def _memory(self, name: str, kinds: list[str], args: list[str]) -> list[str]:
        if kinds[0] == "param":
            return [f"r['{args[0][1:]}'] = np.int64({int(args[1].rsplit('_', 1)[1].rstrip(']'))} << {PAGE})"]
        place = args[1] if name == "ld" else args[0]
        base, _, offset = place.strip("[]").partition("+")
        address = f"m.at({self._read(base, 's64')} + {int(offset or 0)})"
        if name == "ld":
            return [f"r['{args[0][1:]}'] = m.get(*{address})"]
        return [f"m.put(*{address}, {self._read(args[1], 'b32')})"]

    def _test(self, kinds: list[str], args: list[str]) -> list[str]:
        test, kind = kinds[0], kinds[-1]
        a, b = (self._read(x, kind) for x in args[1:3])
        odd = "(np.isnan(a) | np.isnan(b))" if kind == "f32" else "False"
        unordered = kind == "f32" and len(test) == 3 and test.endswith("u")
        text = FLOAT_TESTS[test[:2] if unordered else test].replace("odd", "o")
        text = text.replace("& ~o", "") if unordered or kind != "f32" else text
        lines = [f"a = {a}", f"b = {b}", f"o = {odd}"]
        return [*lines, f"r['{args[0][1:]}'] = {f'({text}) | o' if unordered else text}"]

    def _value(self, name: str, kinds: list[str], kind: str, args: list[str]) -> str:
        if name == "cvta":
            return self._read(args[1], "s64")
        if name == "cvt":
            return self._converted(kinds, args[1])
        if name == "selp":
            return f"np.where({self._read(args[3], 'pred')}, {self._read(args[1], kind)}, {self._read(args[2], kind)})"
        if name == "shfl":
            return f"m.shuffled({self._read(args[1], 'b32')}, {self._read(args[2], 's32')})"
        if name == "vote":
            return f"m.{'some' if 'any' in kinds else 'every'}({self._read(args[1], 'pred')})"
        if name == "mov" and args[1] in ("%tid.x", "%ctaid.x"):
            return f"m.{args[1][1:-2]}"
        if name == "mov" and args[1] in self.tables:
            return f"np.int64({self.tables[args[1]][0]} << {PAGE})"
        if name == "shf":
            a, b, by = (f"np.uint64(1) * {self._read(x, 'u32')}" for x in args[1:4])
            return f"((({b} << np.uint64(32)) | {a}) << ({by} & np.uint64(31)) >> np.uint64(32)).astype(np.uint32)"
        if name == "bfe":
            a, first, count = (self._read(x, "u32") for x in args[1:4])
            return f"(({a} >> {first}) & ((np.uint32(1) << {count}) - np.uint32(1)))"
        a, *more = (self._read(x, kind) for x in args[1:])
        if name == "fma":
            return f"np.float32(np.float64({a}) * {more[0]} + {more[1]}).view(np.uint32)"
        if name in ("mul", "mad") and kinds[0] in ("wide", "hi", "lo") and kind.endswith("32"):
            wide = f"(np.int64({a}) * np.int64({more[0]}))"
            product = {"wide": wide, "hi": f"({wide} >> 32).astype(np.{TYPES[kind]})",
                       "lo": f"{wide}.astype(np.{TYPES[kind]})"}[kinds[0]]  # fmt: skip
            return product if name == "mul" else f"({product} + {more[1]})"
        if name == "mad":
            return f"({a} * {more[0]} + {more[1]})"
        text = UNARY[name] if len(args) == 2 else BINARY[name]
        text = re.sub(r"\ba\b", a.replace("\\", "\\\\"), text)
        text = re.sub(r"\bb\b", (more or [""])[0].replace("\\", "\\\\"), text) if more else text
        return f"({text})"

    def _converted(self, kinds: list[str], arg: str) -> str:
        to, was = kinds[-2:]
        a = self._read(arg, was)
        if to == "f32" and was == "f32":
            function = {"rni": "np.rint", "rmi": "np.floor", "rpi": "np.ceil", "rzi": "np.trunc"}[kinds[0]]
            return f"{function}({a})"
        if was == "f32":
            whole = f"np.nan_to_num(np.clip(np.trunc(np.float64({a})), -2.0**31, 2.0**32 - 1))"
            return f"{whole}.astype(np.int64).astype(np.{TYPES[to]})"
        return f"np.asarray({a}).astype(np.{TYPES[to]})"

    def _read(self, arg: str, kind: str) -> str:
        """An operand as numbers of a kind."""
        if arg.startswith("%"):
            name = f"r['{arg[1:]}']"
            return name if kind in ("pred", "b64", "s64", "u64") else f"np.asarray({name}).view(np.{TYPES[kind]})"
        if arg.startswith("0f"):
            return f"np.uint32(0x{arg[2:]}).view(np.{TYPES[kind]})"
        value = int(arg)
        if kind in ("u32", "b32"):
            return f"np.uint32({value % (1 << 32)})"
        return f"np.{TYPES[kind]}({value})"

    def run(self, operands: list[np.ndarray], blocks: int, threads: int) -> None:
        """Change operands as the kernel does."""
        for block in range(blocks):
            warps = [(Memory(operands, self.tables, block, warp, threads), {}) for warp in range(threads // 32)]
            labels: list[str | None] = ["entry"] * len(warps)
            with np.errstate(all="ignore"):
                while any(labels):
                    labels = [self._on(label, *warp) for label, warp in zip(labels, warps, strict=True)]

    def _on(self, label: str | None, memory: "Memory", registers: dict) -> str | None:
        """One warp up to where it waits for the others."""
        while label is not None:
            label = self.code[label](registers, memory)
            if label and label.startswith("stop"):
                break
        return label


class Memory:
    """Operands, and what threads of a warp tell each other."""

    def __init__(self, operands: list[np.ndarray], tables: dict, block: int, warp: int, threads: int):
        self.words = {k: x.reshape(-1).view(np.uint32) for k, x in enumerate(operands)} | dict(tables.values())
        self.tid, self.ctaid = 32 * warp + np.arange(32, dtype=np.uint32), np.full(32, block, np.uint32)

    def at(self, address: Any) -> tuple[np.ndarray, np.ndarray]:
        """Words of an operand, and which."""
        address = np.broadcast_to(address, self.tid.shape)
        return self.words[int(address[0] >> PAGE)], (address & ((1 << PAGE) - 1)) >> 2

    def get(self, words: np.ndarray, at: np.ndarray) -> np.ndarray:
        """From memory."""
        return words[at]

    def put(self, words: np.ndarray, at: np.ndarray, value: Any) -> None:
        """Into memory."""
        words[at] = np.broadcast_to(value, at.shape)

    def shuffled(self, value: Any, lane: Any) -> np.ndarray:
        """What other lanes have."""
        return np.broadcast_to(value, self.tid.shape)[lane]

    def every(self, test: Any) -> bool:
        """Whether it holds in all lanes of the warp."""
        return bool(np.all(test))

    def some(self, test: Any) -> bool:
        """Whether it holds in a lane of the warp."""
        return bool(np.any(test))


def call(code: Any, operands: Any) -> list[Any]:
    """As `launch.call`."""
    changed = [np.array(x) for x in operands]
    Kernel(code.text).run(changed, len(operands[0]), 32 * cuda.MAX_WARPS_PER_BLOCK)
    return [jnp.asarray(changed[k]) for k in ([2] if len(changed) == 3 else [2, 4])]


def told(test: Any) -> bool:
    """Whether all threads branch; they have to do alike."""
    test = np.asarray(test)
    assert test.all() == test.any(), "threads part"
    return bool(test.all())
