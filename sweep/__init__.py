"""Batch experiments with six-legged robots: where does a manoeuvre succeed, and how sure are we?"""

__version__ = "0.1.0"
