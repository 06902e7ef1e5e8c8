"""Compiled kernels are taken from disk only where nobody else can have put them."""

import os
import sys

import pytest

from napari_deltamic.fourier.cuda.compiler import _is_ours


@pytest.mark.skipif(sys.platform == "win32", reason="owners and permissions of POSIX")
def test_whose_a_kept_kernel_is(tmp_path, monkeypatch):
    folder = tmp_path / "kernels"
    folder.mkdir(mode=0o700)
    path = folder / "kernel.bin"
    path.touch(mode=0o644)
    assert _is_ours(path)
    for one, mode in ((folder, 0o777), (path, 0o666)):
        before = one.stat().st_mode
        one.chmod(mode)
        assert not _is_ours(path)
        one.chmod(before)
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert not _is_ours(path)
