"""Program that compiles LLVM assembly from standard input to PTX on standard output.

It runs in a process of its own, since LLVM ends the process over code that it cannot compile, and XLA's LLVM may be at
work in the caller's. So this file imports nothing of the package.
"""

import sys

import llvmlite.binding as llvm


def main() -> None:
    """Compile LLVM assembly from standard input to PTX for any NVIDIA GPU from Ampere on."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("nvptx64-nvidia-cuda").create_target_machine("sm_80", "+ptx78", opt=3)
    module = llvm.parse_assembly(sys.stdin.read())
    module.verify()
    sys.stdout.write(target.emit_assembly(module))


if __name__ == "__main__":
    main()
