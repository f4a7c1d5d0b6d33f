"""The page of the real service: it is served while the daemon runs, and does not delay its end."""

import http.client
import signal
import subprocess
import sys
import time

import pytest
from prepared import Process, run

pytestmark = pytest.mark.xdist_group("page")


def test_the_service_serves_its_page_and_ends_in_time_with_a_browser_looking(tmp_path, free_port):
    """With a stream open, SIGTERM ends the service within five seconds and with exit code 0."""
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\nhost = "127.0.90.7"\n[store]\ndirectory = "history"\n'
        f'[bus]\nlisten = ["tcp/127.0.90.7:0"]\n[page]\nlisten = "127.0.0.1:{free_port}"\n'
    )
    command = [sys.executable, "-m", "monitor", "run", "--config", str(tmp_path / "cell.toml")]
    with Process(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            until = time.monotonic() + 60.0
            while True:
                try:
                    connection = http.client.HTTPConnection("127.0.0.1", free_port, timeout=10)
                    connection.request("GET", "/api/live")
                    stream = connection.getresponse()
                    break
                except OSError:
                    assert process.poll() is None, process.stderr.read()
                    assert time.monotonic() < until
                    time.sleep(0.2)
            assert stream.readline() == b"event: time\n"
            began = time.monotonic()
            process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=20) == 0
            assert time.monotonic() - began < 5.0
            assert "page on http://127.0.0.1" in process.stderr.read()
        finally:
            process.kill()


def test_an_open_page_without_a_token_is_a_configuration_error(tmp_path):
    """The exit code is 78 and the message names token_file, so that no page is served to a network by mistake."""
    (tmp_path / "cell.toml").write_text(
        '[robot]\nmodel = "ur5"\nsite = "lab"\nid = "cell-1"\n[page]\nlisten = "0.0.0.0:8420"\n[store]\ndirectory = "history"\n'
    )
    command = [sys.executable, "-m", "monitor", "run", "--config", str(tmp_path / "cell.toml")]
    ran = run(command, 100.0)
    assert ran.returncode == 78
    assert "token_file" in ran.stderr
