"""What an idle daemon loads: a daemon waits for days between two replays, beside many others on its host."""

import subprocess
import sys

# what is loaded by a child that computes, by a page, an archive or a study where there is one, and never by a daemon that waits
NOT_WHILE_IDLE = (
    *("scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.special", "scipy.stats"),
    *("filterpy", "jinja2", "matplotlib", "pandas", "pyarrow", "pinocchio", "prometheus_client", "sqlalchemy", "starlette", "tomlkit"),
    *("monitor.cli", "monitor.gateway", "monitor.plant", "monitor.simulate", "monitor.studies"),
    *("monitor.identify.fit", "monitor.identify.identification", "monitor.identify.identify", "monitor.identify.production"),
    *("monitor.identify.signals.cleaning", "monitor.identify.signals.motion", "monitor.identify.validate"),
    *("monitor.judge.alerts.rules", "monitor.judge.assess", "monitor.judge.assessment", "monitor.judge.learn", "monitor.judge.production"),
    *("monitor.service.history.recompute", "monitor.service.page", "monitor.service.production", "monitor.store.formats"),
    *("monitor.views.plots", "monitor.views.report", "monitor.views.web.page_content"),
)


def test_a_daemon_that_waits_loads_nothing_that_only_a_verdict_a_page_or_a_study_needs():
    """Each of these costs every daemon of a host some MiB; a child of some seconds loads them where they are needed."""
    code = "import sys, monitor.service.run; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "monitor.service.main_loop" in found
    assert [name for name in found if any(name == each or name.startswith(f"{each}.") for each in NOT_WHILE_IDLE)] == []


def test_a_configuration_is_read_without_the_judge_and_without_the_service():
    """Every command reads one, and most of them judge nothing."""
    code = "import sys, monitor.config.load; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    rooms = (
        "monitor.judge.belief",
        "monitor.judge.assess",
        "monitor.service",
        "monitor.acquire.safety",
        "monitor.publish.documents",
        "scipy",
    )
    assert [name for name in found if any(name == each or name.startswith(f"{each}.") for each in rooms)] == []
