"""The client against masters that misbehave: cut answers, no streaming, nonsense, hostile text."""
import http.server
import json
import threading
import time
import unicodedata

import pytest

from farm import clean_env, start_tilery, tilery

REPORT = {"job": "j1", "id": "j1", "name": "spot", "state": "rendering", "done": 0.5,
          "left_s": None, "priority": 0, "note": "", "workers": 1, "workers_now": 1,
          "width": 8, "height": 8, "spp_min": 4, "spp_mean": 4, "spp_max": 4,
          "image_sha256": None, "seconds": {"total": 1.0}, "units": {"total": 4}, "events": []}


class Master:
    """An HTTP server whose answers a test chooses: {path: function(handler)}."""

    def __init__(self, routes):
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self):
                outer.seen.append(self.path)
                route = routes.get(self.path.split("?")[0])
                if route:
                    route(self)
                else:
                    answer(self, 404, {"type": "/docs/errors#unknown", "title": "no such page"})

            do_POST = do_PATCH = do_PUT = do_GET

            def log_message(self, *unused):
                pass

        self.seen = []
        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.env = clean_env(TILERY_MASTER=f"http://127.0.0.1:{self.server.server_port}")
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.server.shutdown()
        self.server.server_close()


def answer(handler, status, body, length=None):
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    handler.send_response(status)
    handler.send_header("Content-Type", "application/json")
    handler.send_header("Content-Length", str(len(data) if length is None else length))
    handler.end_headers()
    handler.wfile.write(data)


def refuse_stream(handler):
    answer(handler, 503, {"type": "/docs/errors#busy", "title": "no streams here"})


def test_cut_picture(tmp_path):
    """A picture that ends early is no picture: exit 4, OUT as it was."""
    out = tmp_path / "a.exr"
    out.write_text("precious")

    def cut(handler):
        answer(handler, 200, b"x" * 1000, length=5000)
        handler.close_connection = True

    with Master({"/api/v1/jobs/j1/picture.exr": cut}) as master:
        done = tilery("get", "j1", "-o", out, env=master.env)
    assert done.returncode == 4, done.stderr
    assert out.read_text() == "precious"
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_watch_without_a_stream():
    """Where events cannot be streamed, asking at intervals does."""
    asked = []

    def job(handler):
        asked.append(time.monotonic())
        state = {"state": "done", "done": 1} if len(asked) > 3 else {"done": 0.2 * len(asked)}
        answer(handler, 200, {**REPORT, **state})

    with Master({"/api/v1/jobs/j1": job, "/api/v1/events": refuse_stream}) as master:
        done = tilery("watch", "j1", env=master.env, timeout=20)
    assert done.returncode == 0, done.stderr
    assert "done in" in done.stderr and " 60%" in done.stderr


def test_stream_that_breaks_resumes():
    """The last event's id is sent again; what was half said is dropped."""
    resumed = []

    def events(handler):
        resumed.append(handler.headers.get("Last-Event-ID"))
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        handler.send_header("Connection", "close")
        handler.end_headers()
        if len(resumed) == 1:
            handler.wfile.write(b'id: 7-1\nevent: log\ndata: {"job":"j1","line":"first"}\n\n'
                                b'id: 7-2\nevent: log\ndata: {"job":"j1","line":"half')
        else:
            handler.wfile.write(b"id: 7-3\nevent: job\ndata: "
                                b"{\"id\":\"j1\",\"state\":\"done\",\"done\":1}\n\n")
            handler.wfile.flush()
            time.sleep(1)
        handler.close_connection = True

    with Master({"/api/v1/jobs/j1": lambda h: answer(h, 200, REPORT),
                 "/api/v1/events": events}) as master:
        done = tilery("watch", "j1", env=master.env, timeout=20)
    assert resumed[:2] == [None, "7-1"]
    assert done.stderr.count("first") == 1 and "half" not in done.stderr
    assert "done in" in done.stderr or "rendering after" in done.stderr


def test_job_that_fails():
    """The cause in words; exit 1."""
    failed = {**REPORT, "state": "failed", "note": "unit 7 failed 3 times: out of memory"}
    with Master({"/api/v1/jobs/j1": lambda h: answer(h, 200, failed),
                 "/api/v1/events": refuse_stream}) as master:
        done = tilery("watch", "j1", env=master.env, timeout=20)
    assert done.returncode == 1
    assert "j1 failed: unit 7 failed 3 times: out of memory" in done.stderr


def test_nonfinite_samples_are_told():
    """A warning is not silenced by --quiet."""
    for bad, words in ((2, "2 non-finite samples"), (1, "1 non-finite sample "), (0, "")):
        report = {**REPORT, "state": "done", "done": 1, "nonfinite_samples": bad}
        with Master({"/api/v1/jobs/j1": lambda h, report=report: answer(h, 200, report),
                     "/api/v1/events": refuse_stream}) as master:
            done = tilery("watch", "j1", "--quiet", env=master.env, timeout=20)
        assert done.returncode == 0 and words in done.stderr
        assert (done.stderr == "") == (bad == 0), done.stderr


# Escapes, a C1 control, a mark that turns what follows around, a line separator.
HOSTILE = "\x1b[31mred\x07\r\nrow\x9b\u202egnp.exe\u2028\u2066\ufeff"


def test_names_cannot_steer_the_terminal():
    """Names, notes and errors of others come out without controls, of a terminal or of direction."""
    job = {**REPORT, "name": HOSTILE, "note": HOSTILE, "age_s": 3,
           "events": [{"t": 1, "text": HOSTILE}]}
    problem = {"type": "/docs/errors#x" + HOSTILE, "detail": HOSTILE,
               "errors": [{"pointer": "#/" + HOSTILE, "detail": HOSTILE, "nearest": HOSTILE}]}
    routes = {"/api/v1/jobs": lambda h: answer(h, 200, {"items": [job], "next": None}),
              "/api/v1/jobs/j1": lambda h: answer(h, 200, job),
              "/api/v1/jobs/j2": lambda h: answer(h, 422, problem)}
    with Master(routes) as master:
        for arguments in (("jobs",), ("status", "j1"), ("status", "j2")):
            done = tilery(*arguments, env=master.env)
            text = done.stdout + done.stderr
            assert "red" in text
            assert all(c == "\n" or unicodedata.category(c) not in ("Cc", "Cf", "Zl", "Zp")
                       for c in text), repr(text)


NONSENSE = [b"", b"{", b"[]", b"null", b'{"items":3}', b'{"items":[1,null,{"id":5,"left_s":[1]}]}',
            b"[" * 100000, b"\xff\xfe", b'{"items":[],"next":"/../x?&"}', b'{"a":1,"a":2}']


@pytest.mark.parametrize("body", NONSENSE, ids=[str(n) for n in range(len(NONSENSE))])
def test_nonsense_is_survived(body, tmp_path):
    """Any body: an answer or exit 4, never a crash or a hang."""
    reply = lambda h: answer(h, 200, body)  # noqa: E731
    routes = {path: reply for path in ("/api/v1/jobs", "/api/v1/workers", "/api/v1/jobs/j1",
                                       "/api/v1/jobs/j1/picture.exr")}
    with Master(routes) as master:
        for arguments in (("jobs",), ("jobs", "--json"), ("workers",), ("status", "j1"),
                          ("cancel", "j1"), ("retry", "j1")):
            done = tilery(*arguments, env=master.env, timeout=15)
            assert done.returncode in (0, 1, 4), (arguments, done.returncode, done.stderr)


def test_redirects_are_not_followed():
    """A token must not travel to another host."""
    def away(handler):
        handler.send_response(302)
        handler.send_header("Location", "http://127.0.0.1:1/")
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    with Master({"/api/v1/jobs": away}) as master:
        done = tilery("jobs", env={**master.env, "TILERY_TOKEN": "secret-of-mine"})
        assert done.returncode == 4 and "secret-of-mine" not in done.stderr
        assert len(master.seen) == 1


def test_closed_pipe():
    """`tilery jobs | head`: no noise, no crash."""
    items = [{**REPORT, "id": f"j{n}", "age_s": 1} for n in range(50)]
    page = {"items": items, "next": None}
    with Master({"/api/v1/jobs": lambda h: answer(h, 200, page)}) as master:
        process = start_tilery("jobs", env=master.env)
        process.stdout.close()
        err = process.stderr.read()
        process.stderr.close()
        assert process.wait(10) in (0, 5)
    assert err == ""
