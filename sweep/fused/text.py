"""Lines of LLVM's assembly: names, constants and arithmetic, on vectors of rollouts or on plain numbers.

No operation is reordered and none made less exact: only a product and the sum that takes it may be one rounding.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

TYPES = {"float32": "float", "float64": "double", "int32": "i32", "uint32": "i32", "int64": "i64", "uint64": "i64",
         "bool": "i1", "int8": "i8", "uint8": "i8"}  # fmt: skip
FLOAT_COMPARE = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
FLOAT = {"add": "fadd contract", "sub": "fsub contract", "mul": "fmul contract", "div": "fdiv", "rem": "frem"}
WHOLE = {"add": "add", "sub": "sub", "mul": "mul", "div": "sdiv", "rem": "srem", "and": "and", "or": "or", "xor": "xor",
         "shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}  # fmt: skip
INTRINSICS = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "round": "roundeven", "sin": "sin", "cos": "cos",
              "tan": "tan", "exp": "exp", "log": "log", "pow": "pow", "acos": "acos", "asin": "asin", "atan": "atan",
              "atan2": "atan2"}  # fmt: skip


class Text:
    """A function that is being written, on vectors of `lanes` numbers; 1: on numbers."""

    def __init__(self, lanes: int):
        self.lanes = lanes
        self.lines: list[str] = []
        self.label = "entry"
        self.declared: set[str] = set()
        self._fresh = 0

    def body(self) -> str:
        """The lines written so far, as text."""
        return "\n".join(f"  {line}" if not line.endswith(":") else line for line in self.lines)

    def fresh(self) -> str:
        """A name that is not taken."""
        self._fresh += 1
        return f"%v{self._fresh}"

    def emit(self, text: str, name: str | None = None) -> str:
        """A line that gives a value its name."""
        name = name or self.fresh()
        self.lines.append(f"{name} = {text}")
        return name

    def start(self, label: str) -> None:
        """Begin a basic block of this label."""
        self.lines.append(f"{label}:")
        self.label = label

    def switch(self, kind: str, index: str, name: str, count: int) -> None:
        """Go on in the block of a number, of `name`_0, `name`_1, ...: the nearest of them."""
        if kind != "i1":
            below = self.emit(f"icmp slt {kind} {index}, 0")
            index = self.emit(f"select i1 {below}, {kind} 0, {kind} {index}")
        cases = " ".join(f"{kind} {k}, label %{name}_{k}" for k in range(count - 1))
        self.lines.append(f"switch {kind} {index}, label %{name}_{count - 1} [{cases}]")

    def vector(self, dtype: str) -> str:
        """LLVM's name for a number in all lanes."""
        return TYPES[dtype] if self.lanes == 1 else f"<{self.lanes} x {TYPES[dtype]}>"

    def short(self, dtype: str) -> str:
        """The type in the names of LLVM's own functions."""
        kind = {"float": "f32", "double": "f64"}.get(TYPES[dtype], TYPES[dtype])
        return kind if self.lanes == 1 else f"v{self.lanes}{kind}"

    def splat(self, kind: str, value: Any) -> str:
        """A constant of one value in all lanes."""
        return str(value) if self.lanes == 1 else "<" + ", ".join([f"{kind} {value}"] * self.lanes) + ">"

    def literal(self, value: Any) -> str:
        """A constant in all lanes."""
        value = np.asarray(value)
        kind = TYPES[value.dtype.name]
        if value.dtype == bool:
            return self.splat(kind, "true" if value else "false")
        if value.dtype.kind == "f":
            return self.splat(kind, f"0x{np.float64(value).view(np.uint64):016X}")
        return self.splat(kind, int(value))

    def call(self, name: str, dtype: str, args: Sequence[str], extra: str = "") -> str:
        """One of LLVM's own functions."""
        vector, function = self.vector(dtype), f"@llvm.{name}.{self.short(dtype)}"
        self.declared.add(f"declare {vector} {function}({', '.join([vector] * len(args))}{', i1' if extra else ''})")
        return self.emit(f"call {vector} {function}({', '.join(f'{vector} {x}' for x in args)}{extra})")

    def arithmetic(self, op: str, dtype: str, args: list[str], kinds: Sequence[str]) -> str:
        """An operation on vectors."""
        of, vector = kinds[-1], self.vector(kinds[-1])
        floating = np.issubdtype(of, np.floating)
        match op:
            case "select":
                return self.emit(f"select {self.vector('bool')} {args[0]}, {vector} {args[1]}, {vector} {args[2]}")
            case "convert":
                return self._convert(args[0], of, dtype)
            case "bitcast_convert_type":
                return self.emit(f"bitcast {vector} {args[0]} to {self.vector(dtype)}")
            case "is_finite":
                size = self.call("fabs", of, args)
                return self.emit(f"fcmp olt {vector} {size}, {self.literal(np.asarray(np.inf, of))}")
            case "not":
                ones = self.splat(TYPES[of], "true" if of == "bool" else -1)
                return self.emit(f"xor {vector} {args[0]}, {ones}")
            case "neg":
                return self.emit(f"fneg {vector} {args[0]}" if floating else f"sub {vector} zeroinitializer, {args[0]}")
            case "abs":
                return self.call("fabs", of, args) if floating else self.call("abs", of, args, ", i1 false")
            case "max" | "min" if floating:
                return self.extreme(op, of, args)
            case "max" | "min":
                sign = "u" if of.startswith("u") or of == "bool" else "s"
                return self.call(f"{sign}{op}", of, args)
            case _ if op in FLOAT_COMPARE and floating:
                return self.emit(f"fcmp {FLOAT_COMPARE[op]} {vector} {args[0]}, {args[1]}")
            case _ if op in FLOAT_COMPARE:
                sign = "" if op in ("eq", "ne") else "u" if of.startswith("u") or of == "bool" else "s"
                return self.emit(f"icmp {sign}{op} {vector} {args[0]}, {args[1]}")
            case _ if op in INTRINSICS and floating:
                return self.call(INTRINSICS[op], of, args)
            case _ if floating:
                return self.emit(f"{FLOAT[op]} {vector} {args[0]}, {args[1]}")
            case _:
                unsigned = {"sdiv": "udiv", "srem": "urem"} if of.startswith("u") else {}
                return self.emit(f"{unsigned.get(WHOLE[op], WHOLE[op])} {vector} {args[0]}, {args[1]}")

    def extreme(self, op: str, dtype: str, args: list[str]) -> str:
        """The greater or lesser of two; NaN if either is, as the first operand or by the comparison."""
        vector, chosen = self.vector(dtype), self.vector("bool")
        better = self.emit(f"fcmp {'ogt' if op == 'max' else 'olt'} {vector} {args[0]}, {args[1]}")
        best = self.emit(f"select {chosen} {better}, {vector} {args[0]}, {vector} {args[1]}")
        nan = self.emit(f"fcmp uno {vector} {args[0]}, {args[0]}")
        return self.emit(f"select {chosen} {nan}, {vector} {args[0]}, {vector} {best}")

    def _convert(self, value: str, old: str, new: str) -> str:
        a, b = self.vector(old), self.vector(new)
        was, to = np.dtype(old), np.dtype(new)
        if to.kind == "b":
            test = "fcmp une" if was.kind == "f" else "icmp ne"
            return self.emit(f"{test} {a} {value}, zeroinitializer")
        if was.kind == "f" and to.kind == "f":
            return self.emit(f"{'fpext' if to.itemsize > was.itemsize else 'fptrunc'} {a} {value} to {b}")
        if was.kind == "f":
            name = f"@llvm.fpto{'u' if to.kind == 'u' else 's'}i.sat.{self.short(new)}.{self.short(old)}"
            self.declared.add(f"declare {b} {name}({a})")
            return self.emit(f"call {b} {name}({a} {value})")
        if to.kind == "f":
            return self.emit(f"{'sitofp' if was.kind == 'i' else 'uitofp'} {a} {value} to {b}")
        if TYPES[old] == TYPES[new]:
            return value
        wider = "sext" if was.kind == "i" else "zext"
        return self.emit(f"{wider if was.kind == 'b' or to.itemsize > was.itemsize else 'trunc'} {a} {value} to {b}")
