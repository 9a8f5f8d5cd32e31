"""Ctrl-C while a solution is written."""

import gc
import zipfile

import pytest

import fx_beam as fb


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_in_save_is_no_other_error_and_leaves_the_earlier_file(tmp_path, monkeypatch):
    scene = fb.Scene()
    scene.add_body((0, 0), mass=1.0, inertia=1.0)
    solution = fb.simulate(scene, dt=0.1, t_end=0.2)
    (tmp_path / "run.npz").write_bytes(b"earlier")
    real = zipfile.ZipFile.open

    def interrupted(self, *arguments, **options):
        part = real(self, *arguments, **options)
        if arguments[0] == "q.npy":
            raise KeyboardInterrupt  # before the part is known outside
        return part

    with monkeypatch.context() as patched:
        patched.setattr(zipfile.ZipFile, "open", interrupted)
        with pytest.raises(KeyboardInterrupt):
            solution.save(tmp_path / "run.npz")
    gc.collect()  # what complains while it is collected fails the test
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"earlier"]
