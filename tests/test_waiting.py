import time

from sweep.core import waiting


def test_a_wait_in_a_pipe_is_told_and_remembered(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(waiting, "FIRST", 0.05)
    assert waiting.last_time("walk for mjx") == ""
    waiting.remember("walk for mjx", 17.2)
    with waiting.waiting(f"compiling walk for mjx{waiting.last_time('walk for mjx')}"):
        time.sleep(0.3)
    out, err = capsys.readouterr()
    assert not out
    assert err == "sweep: compiling walk for mjx (17 s last time), 0 s\n"
    with waiting.waiting("short"):
        pass
    assert not capsys.readouterr().err
