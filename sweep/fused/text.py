"""Printing of LLVM assembly: names, constants and arithmetic, on vectors of rollouts or single numbers.

No operation is reordered or made less accurate; only a product and the sum that takes it may be rounded together (FMA).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

LLVM_TYPES = {"float32": "float", "float64": "double", "int32": "i32", "uint32": "i32", "int64": "i64", "uint64": "i64",
              "bool": "i1", "int8": "i8", "uint8": "i8"}  # fmt: skip
FLOAT_COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
FLOAT_INSTRUCTIONS = {
    "add": "fadd contract",
    "sub": "fsub contract",
    "mul": "fmul contract",
    "div": "fdiv",
    "rem": "frem",
}
INTEGER_INSTRUCTIONS = {"add": "add", "sub": "sub", "mul": "mul", "div": "sdiv", "rem": "srem", "and": "and",
                        "or": "or", "xor": "xor", "shift_left": "shl", "shift_right_logical": "lshr",
                        "shift_right_arithmetic": "ashr"}  # fmt: skip
INTRINSICS = {"sqrt": "sqrt", "floor": "floor", "ceil": "ceil", "round": "roundeven", "sin": "sin", "cos": "cos",
              "tan": "tan", "exp": "exp", "log": "log", "pow": "pow", "acos": "acos", "asin": "asin", "atan": "atan",
              "atan2": "atan2"}  # fmt: skip


class LlvmFunctionPrinter:
    """Prints an LLVM function line by line, on vectors of `lanes` numbers (one a rollout) or on single numbers."""

    def __init__(self, lanes: int):
        self.lanes = lanes
        self.lines: list[str] = []
        self.label = "entry"
        self.declared: set[str] = set()
        self._fresh = 0

    def printed_lines(self) -> str:
        """Return the lines printed so far."""
        return "\n".join(f"  {line}" if not line.endswith(":") else line for line in self.lines)

    def fresh_name(self) -> str:
        """Return a name that no value of the printed function has."""
        self._fresh += 1
        return f"%v{self._fresh}"

    def emit(self, text: str, name: str | None = None) -> str:
        """Print a line that defines a value, and return the value's name.

        Args:
            text: the instruction.
            name: name of the value; by default a new one.
        """
        name = name or self.fresh_name()
        self.lines.append(f"{name} = {text}")
        return name

    def start_block(self, label: str) -> None:
        """Begin a basic block of LLVM code with a label."""
        self.lines.append(f"{label}:")
        self.label = label

    def print_switch(self, kind: str, index: str, name: str, count: int) -> None:
        """Print a jump to the block `name`_k for an index k, clamped to 0 .. count - 1.

        Args:
            kind: type of the index.
            index: name of the index.
            name: prefix of the blocks' labels.
            count: number of blocks.
        """
        if kind != "i1":
            below = self.emit(f"icmp slt {kind} {index}, 0")
            index = self.emit(f"select i1 {below}, {kind} 0, {kind} {index}")
        cases = " ".join(f"{kind} {k}, label %{name}_{k}" for k in range(count - 1))
        self.lines.append(f"switch {kind} {index}, label %{name}_{count - 1} [{cases}]")

    def vector_type(self, dtype: str) -> str:
        """Return the LLVM type of a vector that holds a number for each of several rollouts (lanes)."""
        return LLVM_TYPES[dtype] if self.lanes == 1 else f"<{self.lanes} x {LLVM_TYPES[dtype]}>"

    def intrinsic_type_suffix(self, dtype: str) -> str:
        """Return the suffix that LLVM intrinsics have for a number type, such as `f32`."""
        kind = {"float": "f32", "double": "f64"}.get(LLVM_TYPES[dtype], LLVM_TYPES[dtype])
        return kind if self.lanes == 1 else f"v{self.lanes}{kind}"

    def splat(self, kind: str, value: Any) -> str:
        """Return the LLVM constant of type `kind` that repeats one value for all rollouts of a vector."""
        return str(value) if self.lanes == 1 else "<" + ", ".join([f"{kind} {value}"] * self.lanes) + ">"

    def literal(self, value: Any) -> str:
        """Return a number as an LLVM constant, repeated for all rollouts of a vector."""
        value = np.asarray(value)
        kind = LLVM_TYPES[value.dtype.name]
        if value.dtype == bool:
            return self.splat(kind, "true" if value else "false")
        if value.dtype.kind == "f":
            return self.splat(kind, f"0x{np.float64(value).view(np.uint64):016X}")
        return self.splat(kind, int(value))

    def call_intrinsic(self, name: str, dtype: str, args: Sequence[str], extra: str = "") -> str:
        """Print the call of an LLVM intrinsic.

        Args:
            name: the intrinsic.
            dtype: type of the result.
            args: names of the operands.
            extra: further operands as text.
        """
        vector, function = self.vector_type(dtype), f"@llvm.{name}.{self.intrinsic_type_suffix(dtype)}"
        self.declared.add(f"declare {vector} {function}({', '.join([vector] * len(args))}{', i1' if extra else ''})")
        return self.emit(f"call {vector} {function}({', '.join(f'{vector} {x}' for x in args)}{extra})")

    def print_arithmetic(self, op: str, dtype: str, args: list[str], kinds: Sequence[str]) -> str:
        """Print an arithmetic operation on vectors.

        Args:
            op: operation, by JAX's name.
            dtype: type of the result.
            args: names of the operands.
            kinds: their types.
        """
        of, vector = kinds[-1], self.vector_type(kinds[-1])
        floating = np.issubdtype(of, np.floating)
        match op:
            case "select":
                return self.emit(f"select {self.vector_type('bool')} {args[0]}, {vector} {args[1]}, {vector} {args[2]}")
            case "convert":
                return self._convert(args[0], of, dtype)
            case "bitcast_convert_type":
                return self.emit(f"bitcast {vector} {args[0]} to {self.vector_type(dtype)}")
            case "is_finite":
                size = self.call_intrinsic("fabs", of, args)
                return self.emit(f"fcmp olt {vector} {size}, {self.literal(np.asarray(np.inf, of))}")
            case "not":
                ones = self.splat(LLVM_TYPES[of], "true" if of == "bool" else -1)
                return self.emit(f"xor {vector} {args[0]}, {ones}")
            case "neg":
                return self.emit(f"fneg {vector} {args[0]}" if floating else f"sub {vector} zeroinitializer, {args[0]}")
            case "abs":
                return (
                    self.call_intrinsic("fabs", of, args)
                    if floating
                    else self.call_intrinsic("abs", of, args, ", i1 false")
                )
            case "max" | "min" if floating:
                return self.print_max_or_min(op, of, args)
            case "max" | "min":
                sign = "u" if of.startswith("u") or of == "bool" else "s"
                return self.call_intrinsic(f"{sign}{op}", of, args)
            case _ if op in FLOAT_COMPARISONS and floating:
                return self.emit(f"fcmp {FLOAT_COMPARISONS[op]} {vector} {args[0]}, {args[1]}")
            case _ if op in FLOAT_COMPARISONS:
                sign = "" if op in ("eq", "ne") else "u" if of.startswith("u") or of == "bool" else "s"
                return self.emit(f"icmp {sign}{op} {vector} {args[0]}, {args[1]}")
            case _ if op in INTRINSICS and floating:
                return self.call_intrinsic(INTRINSICS[op], of, args)
            case _ if floating:
                return self.emit(f"{FLOAT_INSTRUCTIONS[op]} {vector} {args[0]}, {args[1]}")
            case _:
                unsigned = {"sdiv": "udiv", "srem": "urem"} if of.startswith("u") else {}
                return self.emit(
                    f"{unsigned.get(INTEGER_INSTRUCTIONS[op], INTEGER_INSTRUCTIONS[op])} {vector} {args[0]}, {args[1]}"
                )

    def print_max_or_min(self, op: str, dtype: str, args: list[str]) -> str:
        """Print the LLVM code for the maximum or minimum of two numbers; NaN if either is NaN.

        Args:
            op: `max` or `min`.
            dtype: type of the numbers.
            args: names of the operands.
        """
        vector, chosen = self.vector_type(dtype), self.vector_type("bool")
        better = self.emit(f"fcmp {'ogt' if op == 'max' else 'olt'} {vector} {args[0]}, {args[1]}")
        best = self.emit(f"select {chosen} {better}, {vector} {args[0]}, {vector} {args[1]}")
        nan = self.emit(f"fcmp uno {vector} {args[0]}, {args[0]}")
        return self.emit(f"select {chosen} {nan}, {vector} {args[0]}, {vector} {best}")

    def _convert(self, value: str, from_type: str, to_type: str) -> str:
        a, b = self.vector_type(from_type), self.vector_type(to_type)
        was, to = np.dtype(from_type), np.dtype(to_type)
        if to.kind == "b":
            test = "fcmp une" if was.kind == "f" else "icmp ne"
            return self.emit(f"{test} {a} {value}, zeroinitializer")
        if was.kind == "f" and to.kind == "f":
            return self.emit(f"{'fpext' if to.itemsize > was.itemsize else 'fptrunc'} {a} {value} to {b}")
        if was.kind == "f":
            types = f"{self.intrinsic_type_suffix(to_type)}.{self.intrinsic_type_suffix(from_type)}"
            name = f"@llvm.fpto{'u' if to.kind == 'u' else 's'}i.sat.{types}"
            self.declared.add(f"declare {b} {name}({a})")
            return self.emit(f"call {b} {name}({a} {value})")
        if to.kind == "f":
            return self.emit(f"{'sitofp' if was.kind == 'i' else 'uitofp'} {a} {value} to {b}")
        if LLVM_TYPES[from_type] == LLVM_TYPES[to_type]:
            return value
        wider = "sext" if was.kind == "i" else "zext"
        return self.emit(f"{wider if was.kind == 'b' or to.itemsize > was.itemsize else 'trunc'} {a} {value} to {b}")
