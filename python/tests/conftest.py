"""Where the programs are that the package is compared with. `scripts/check_python` builds them and says."""

import os
import pathlib
import subprocess

import pytest

ROOT = pathlib.Path(__file__).parents[2]


class Programs:
    """The programs in Rust."""

    root = ROOT

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder

    def run(self, name: str, *arguments: object) -> str:
        """What a program prints."""
        command = [str(self.folder / name), *(str(argument) for argument in arguments)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout


@pytest.fixture(scope="session")
def programs() -> Programs:
    """From the folder that `SUPPLE_PROGRAMS` names."""
    folder = os.environ.get("SUPPLE_PROGRAMS")
    if folder is None:
        pytest.fail("SUPPLE_PROGRAMS does not name the folder with the programs: run scripts/check_python")
    return Programs(pathlib.Path(folder))
