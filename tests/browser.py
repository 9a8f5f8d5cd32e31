"""A browser for tests of pages: Chromium without a window, where it is installed."""

import contextlib
import shutil
import subprocess

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
needed = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")


def _command(folder, *options):
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=900,900"]
    return [*command, f"--user-data-dir={folder}", *options]


def dom(page, folder):
    """A page after its scripts ran."""
    options = "--dump-dom", "--allow-file-access-from-files", "--virtual-time-budget=10000"
    command = _command(folder, *options, page.as_uri())
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout


@contextlib.contextmanager
def window(url, folder):
    """In this block a page runs."""
    command = _command(folder, "--remote-debugging-port=0", url)
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()
