"""Under TILERY_NO_SKIP=1 (CI) a skipped test is a failure: nothing is missed in silence."""
import os


def pytest_sessionfinish(session, exitstatus):
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    if os.environ.get("TILERY_NO_SKIP") == "1" and skipped and exitstatus == 0:
        session.exitstatus = 1
