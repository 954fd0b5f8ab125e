from sweep.core.provenance import statements

SOURCE = '''"""What it does."""
def f(x):
    """What f does."""
    return x + 1  # why
class C:
    """What C is."""
'''


def test_words_and_format_do_not_change_the_version_of_the_code_and_all_else_does():
    formatted = "def f(\n    x,\n):\n    # why\n    return (x + 1)\n\n\nclass C:\n    pass\n"
    assert statements(SOURCE) == statements(formatted)
    for old, new in (("x + 1", "x + 2"), ("x + 1", "x + 1.0"), ("f(x)", "f(x, y)"), ("class C", "class D")):
        assert statements(SOURCE) != statements(SOURCE.replace(old, new))
