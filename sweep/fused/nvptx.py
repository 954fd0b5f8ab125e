"""LLVM's assembly from standard input as PTX on standard output, in a process of its own.

What LLVM cannot compile ends its process, and XLA's LLVM may be at work in the one that asks. So this file imports
nothing else.
"""

import sys

import llvmlite.binding as llvm


def main() -> None:
    """For any GPU from Ampere on."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple("nvptx64-nvidia-cuda").create_target_machine("sm_80", "+ptx78", opt=3)
    module = llvm.parse_assembly(sys.stdin.read())
    module.verify()
    sys.stdout.write(target.emit_assembly(module))


if __name__ == "__main__":
    main()
