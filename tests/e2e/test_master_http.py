"""The API of a real tilery-master: what it answers, and what it refuses."""
import contextlib
import hashlib
import http.client
import json
import pathlib
import re
import struct
import subprocess
import time

import pytest

from farm import BIN, Farm, GLASS_SCENE, ROOT, SEED_SCENE, SLOW, clean_env, tilery, wait_until

OPENAPI = json.loads((ROOT / "master/web/openapi.json").read_text())
TOKEN = "a long secret token"


def zstd_raw(data):
    """A zstd frame of raw blocks (RFC 8878), made by hand."""
    out = struct.pack("<IBQ", 0xFD2FB528, 0xE0, len(data))
    blocks = [data[i:i + 100000] for i in range(0, len(data), 100000)] or [b""]
    for i, block in enumerate(blocks):
        head = len(block) << 3 | (i + 1 == len(blocks))
        out += head.to_bytes(3, "little") + block
    return out


class Client:
    """Requests with any header and body; keeps the connection."""

    def __init__(self, farm, token=None):
        host, port = farm.http.split(":")
        self.connection = http.client.HTTPConnection(host, int(port), timeout=20 * SLOW)
        self.token = token

    def __call__(self, method, path, body=None, headers=None):
        headers = dict(headers or {})
        if self.token:
            headers.setdefault("Authorization", f"Bearer {self.token}")
        if isinstance(body, (dict, list)):
            body = json.dumps(body)
        self.connection.request(method, path, body, headers)
        reply = self.connection.getresponse()
        content = reply.read()
        if reply.headers.get("Content-Type", "").endswith("json"):
            content = json.loads(content) if content else None
        return reply.status, content, reply.headers


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    """No worker: jobs stay queued."""
    with Farm(tmp_path_factory.mktemp("http")) as made:
        yield made


@pytest.fixture
def call(farm):
    return Client(farm)


@pytest.fixture(scope="module")
def job(farm):
    """A cancelled job whose package is in the store: (package, spec)."""
    first = farm.submit(SEED_SCENE, "--spp", 4, "--size", "64x64")
    farm.request("PATCH", f"/api/v1/jobs/{first}", {"state": "cancelled"})
    report = farm.job(first)
    return {"name": "by hand", "package": report["package"], "spec": report["spec"]}


def check_problem(reply, status, kind):
    assert reply[0] == status, reply
    assert reply[2]["Content-Type"] == "application/problem+json"
    problem = reply[1]
    assert problem["status"] == status and problem["detail"] and problem["title"], problem
    assert problem["type"] == f"/docs/errors#{kind}", problem
    return problem


# --- Chunks -----------------------------------------------------------------------------------


def test_chunks(call):
    data = b"some bytes " * 20000
    name = hashlib.sha256(data).hexdigest()
    other = hashlib.sha256(b"other").hexdigest()
    missing = "/api/v1/chunks/missing"
    assert call("POST", missing, {"sha256": [name, other]})[1] == {"missing": [name, other]}
    assert call("PUT", f"/api/v1/chunks/{name}", zstd_raw(data))[0] == 201
    assert call("PUT", f"/api/v1/chunks/{name}", zstd_raw(data))[0] == 200
    assert call("POST", missing, {"sha256": [name, other]})[1] == {"missing": [other]}


@pytest.mark.parametrize("body", [b"", b"garbage", zstd_raw(b"not that"), zstd_raw(b"right")[:-1],
                                  zstd_raw(b"right") + b"more", b"\x28\xb5\x2f\xfd" + b"\xff" * 40],
                         ids=["empty", "garbage", "other", "cut", "more", "bad-header"])
def test_wrong_chunk_is_refused(call, body):
    name = hashlib.sha256(b"right").hexdigest()
    check_problem(call("PUT", f"/api/v1/chunks/{name}", body), 422, "bad-chunk")
    assert call("POST", "/api/v1/chunks/missing", {"sha256": [name]})[1] == {"missing": [name]}


def test_bomb_is_refused(farm, call):
    """A frame that claims 16 EiB takes no memory."""
    frame = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 2**64 - 1) + b"\x02\x00\x00" + b"x"
    name = hashlib.sha256(b"bomb").hexdigest()
    before = memory_of(farm)
    status = call("PUT", f"/api/v1/chunks/{name}", frame)[0]
    assert status == 422
    assert memory_of(farm) - before < 64 << 20


def memory_of(farm):
    status = pathlib.Path(f"/proc/{farm.master.pid}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) << 10


def test_bad_digests(call):
    check_problem(call("PUT", "/api/v1/chunks/xyz", b""), 400, "bad-digest")
    problem = check_problem(call("POST", "/api/v1/chunks/missing", {"sha256": ["x", 1]}), 422,
                            "bad-request")
    assert len(problem["errors"]) == 2
    assert problem["errors"][0]["pointer"] == "$.sha256[0]"


# --- Jobs -------------------------------------------------------------------------------------


def test_submit_and_report(call, job):
    status, report, headers = call("POST", "/api/v1/jobs", job)
    assert status == 201
    assert headers["Location"] == f"/api/v1/jobs/{report['id']}"
    assert report["state"] == "queued" and report["name"] == "by hand"
    status, again, headers = call("GET", headers["Location"])
    assert status == 200 and again["id"] == report["id"]
    assert re.fullmatch(f'"[0-9]+-r{again["rev"]}"', headers["ETag"])
    needed = OPENAPI["components"]["schemas"]["Job"]["required"]
    assert not set(needed) - set(again), set(needed) - set(again)
    assert not set(again) - set(needed), set(again) - set(needed)
    for part in ("seconds", "units", "bytes", "error"):
        names = OPENAPI["components"]["schemas"]["Job"]["properties"][part]["required"]
        assert set(again[part]) == set(names)
    assert again["image_sha256"] is None and again["error"]["relmse"] is None
    assert again["note"] in ("no worker", "")


def test_long_name_is_cut_between_characters(call, job):
    report = call("POST", "/api/v1/jobs", {**job, "name": "n" + "\u00e9" * 150})[1]
    assert report["name"] == "n" + "\u00e9" * 99


def test_missing_package(call, job):
    name = "ab" * 32
    problem = check_problem(call("POST", "/api/v1/jobs", {**job, "package": name}), 422,
                            "missing-chunk")
    assert name in problem["errors"][0]["detail"]


def test_chunk_that_is_no_package(call, job):
    name = hashlib.sha256(b"no package").hexdigest()
    assert call("PUT", f"/api/v1/chunks/{name}", zstd_raw(b"no package"))[0] == 201
    check_problem(call("POST", "/api/v1/jobs", {**job, "package": name}), 422, "bad-package")


@pytest.mark.parametrize("change, place", [
    ({"package": "xyz"}, "$.package"),
    ({"package": 5}, "$.package"),
    ({"package": None}, "$.package"),
    ({"name": ["x"]}, "$.name"),
    ({"priority": "high"}, "$.priority"),
    ({"priority": 1e300}, "$.priority"),
    ({"spec": []}, "$.spec"),
    ({"spec": {"width": 0}}, "$.width"),
    ({"spec": {"width": 70000, "height": 10}}, "$.width"),
    ({"spec": {"spp": -1}}, "$.spp"),
    ({"spec": {"colour": 1}}, "$.colour"),
    ({"spec": {"integrator": "magic"}}, "$.integrator"),
    ({"spec": {"aov": "depth,depht"}}, "$.aov"),
    ({"spec": {"aov": "depth,depth"}}, "$.aov"),
    ({"spec": {"aov": "depth," * 2000}}, "$.aov"),
    ({"spec": {"aov": ["depth"]}}, "$.aov"),
    ({"spec": {"aov": ""}}, "$.aov"),
    ({"spec": {"tags": "big,big"}}, "$.tags"),
    ({"spec": {"tags": "a,b,c,d,e,f,g,h,i"}}, "$.tags"),
    ({"spec": {"tags": "x" * 33}}, "$.tags"),
    ({"spec": {"tags": "gr\u00fcn"}}, "$.tags"),
    ({"spec": {"tags": 7}}, "$.tags"),
    ({"spec": {"verify": 1.5}}, "$.verify"),
    ({"spec": {"verify": "5%"}}, "$.verify"),
    ({"spec": {"precision": "fast and loose"}}, "$.precision"),
    ({"spec": {"stop": "never"}}, "$.stop"),
    ({"spec": {"stop": "error", "target_error": -1}}, "$.target_error"),
    ({"spec": {"stop": "time", "time_limit": 1e300}}, "$.time_limit"),
    ({"spec": {"crop": [0, 0, 0, 1]}}, "$.crop"),
    ({"spec": {"seed": "18446744073709551616"}}, "$.seed"),
    ({"frame": -1}, "$.frame"),
    ({"frame": 2 ** 32}, "$.frame"),
    ({"frame": "7"}, "$.frame"),
    ({"frame": 7, "shot": "w1"}, "$.shot"),
    ({"frame": 7, "shot": "j0"}, "$.shot"),
    ({"frame": 7, "shot": {"job": "j1"}}, "$.shot"),
    ({"frame": 7, "shot": "j" + "9" * 40}, "$.shot"),
    ({"shot": "j1"}, "$.shot"),
    ({"plan": []}, "$.plan"),
    ({"plan": {}}, "$.plan"),
    ({"plan": {"columns": 2, "rows": 1, "max_spp": 64, "pilot": "kept", "spp": [4]}}, "$.plan.spp"),
    ({"plan": {"columns": 4096, "rows": 4096, "max_spp": 64, "pilot": "kept", "spp": []}}, "$.plan.spp"),
    ({"plan": {"columns": 1, "rows": 1, "max_spp": 64, "pilot": "kept", "spp": [-4]}}, "$.plan.spp"),
    ({"plan": {"columns": 1, "rows": 1, "max_spp": 64, "pilot": "kept", "spp": [1e999]}}, "$"),
    ({"plan": {"columns": 1, "rows": 1, "max_spp": 64, "pilot": "kept", "spp": [4], "square": 8}}, "$.plan"),
    ({"preset": "fast.preset"}, "$.preset"),
    ({"tls": {"ca": "/etc/passwd"}}, "$.tls"),
])
def test_bad_job(call, job, change, place):
    before = len(call("GET", "/api/v1/jobs?limit=1000")[1]["items"])
    status, problem, _ = call("POST", "/api/v1/jobs", {**job, **change})
    assert status in (400, 422), problem
    assert any(place in e["pointer"] for e in problem["errors"]), problem
    assert len(call("GET", "/api/v1/jobs?limit=1000")[1]["items"]) == before


PLAN = {"columns": 4, "rows": 4, "max_spp": 64, "pilot": "dropped", "spp": [16] * 16}


@pytest.mark.parametrize("spec, plan", [
    ({"stop": "plan"}, None),                                # asks for one and has none
    ({}, PLAN),                                              # has one and does not ask
    ({"stop": "plan", "spp": 65536}, PLAN),                  # its blocks are others
    ({"stop": "plan", "width": 80}, PLAN),                   # wider than the plan
    ({"stop": "plan"}, {**PLAN, "column": 1}),               # beside the picture
    ({"stop": "plan"}, {**PLAN, "spp": [16] * 15 + [17]}),   # no number of blocks
    ({"stop": "plan"}, {**PLAN, "spp": [16] * 15 + [128]}),  # over its own most
])
def test_plan_that_does_not_fit(call, job, spec, plan):
    body = {**job, "spec": {"width": 64, "height": 64, "spp": 64, **spec}}
    if plan:
        body["plan"] = plan
    status, problem, _ = call("POST", "/api/v1/jobs", body)
    assert status == 422 and problem["title"], problem
    assert call("GET", "/healthz")[0] == 200


def test_frame_of_no_shot(call, job):
    check_problem(call("POST", "/api/v1/jobs", {**job, "frame": 7, "shot": "j4294967295"}), 422,
                  "unknown-job")


@pytest.mark.parametrize("body", ["", "{", "[]", "null", "nonsense", '{"a":1,"a":2}', "[" * 100000,
                                  '{"unknown": 1}', "\x00", '{"name":"\ud800"}'.encode("utf-8", "surrogatepass"),
                                  '{"priority": 1e999}'])
def test_bad_json(call, body):
    status, problem, headers = call("POST", "/api/v1/jobs", body)
    assert status in (400, 422) and headers["Content-Type"] == "application/problem+json"
    assert problem["errors"]


def test_idempotency_key(farm, call, job):
    key = {"Idempotency-Key": "k1"}
    first = call("POST", "/api/v1/jobs", job, key)
    again = call("POST", "/api/v1/jobs", job, key)
    assert first[0] == again[0] == 201 and first[1]["id"] == again[1]["id"]
    check_problem(call("POST", "/api/v1/jobs", {**job, "name": "other"}, key), 422, "key-reused")
    other = call("POST", "/api/v1/jobs", job, {"Idempotency-Key": "k2"})
    assert other[1]["id"] != first[1]["id"]


def test_list_pages(call, job):
    made = [call("POST", "/api/v1/jobs", {**job, "name": f"n{i}"})[1]["id"] for i in range(5)]
    seen, cursor = [], ""
    while True:
        status, page, _ = call("GET", f"/api/v1/jobs?limit=2{cursor}")
        assert status == 200 and len(page["items"]) <= 2
        seen += [item["id"] for item in page["items"]]
        if not page["next"]:
            break
        cursor = f"&cursor={page['next']}"
    assert seen == sorted(set(seen), key=lambda i: -int(i[1:]))
    assert set(made) <= set(seen)
    states = {i["state"] for i in call("GET", "/api/v1/jobs?state=cancelled,done")[1]["items"]}
    assert states <= {"cancelled", "done"}
    needed = OPENAPI["components"]["schemas"]["JobItem"]["required"]
    assert set(page["items"][0]) == set(needed)
    for query in ("state=flying", "limit=0", "limit=x", "limit=1001", "cursor=x", "state="):
        check_problem(call("GET", f"/api/v1/jobs?{query}"), 400, "bad-query")


def test_changes(call, job):
    path = "/api/v1/jobs/" + call("POST", "/api/v1/jobs", job)[1]["id"]
    assert call("PATCH", path, {"priority": 7})[1]["priority"] == 7
    assert call("PATCH", path, {"state": "paused"})[1]["state"] == "paused"
    check_problem(call("PATCH", path, {"state": "paused"}), 409, "wrong-state")
    assert call("PATCH", path, {"state": "queued"})[1]["state"] == "queued"
    check_problem(call("PATCH", path, {"state": "queued"}), 409, "wrong-state")
    check_problem(call("PATCH", path, {"state": "done"}), 409, "wrong-state")
    stale = {"If-Match": '"r0"'}
    check_problem(call("PATCH", path, {"priority": 1}, stale), 412, "stale")
    for body in ({}, {"state": "paused", "priority": 1}, {"state": "flying"}):
        check_problem(call("PATCH", path, body), 422, "bad-change")
    check_problem(call("PATCH", path, {"priority": 1, "x": 2}), 400, "bad-request")
    assert call("PATCH", path, {"state": "cancelled"})[1]["state"] == "cancelled"
    check_problem(call("PATCH", path, {"state": "cancelled"}), 409, "wrong-state")
    check_problem(call("PATCH", path, {"priority": 1}), 409, "wrong-state")
    assert call("PATCH", path, {"state": "queued"})[1]["state"] == "queued"
    for name in ("j0", "j999999", "w1", "j1x", "x", "j01", "j" + "9" * 30):
        check_problem(call("PATCH", f"/api/v1/jobs/{name}", {"priority": 1}), 404, "unknown-job")


def test_picture_of_an_unfinished_job(call, job):
    path = "/api/v1/jobs/" + call("POST", "/api/v1/jobs", job)[1]["id"]
    problem = check_problem(call("GET", path + "/picture.exr"), 409, "unfinished")
    assert problem["detail"] == "the job is queued, 0.0 % done; its picture is not finished"
    status, content, headers = call("GET", path + "/picture.png?partial=1")
    assert status == 200 and content.startswith(b"\x89PNG") and headers["Content-Type"] == "image/png"
    status, content, _ = call("GET", path + "/picture.exr?partial=1")
    assert status == 200 and content.startswith(b"\x76\x2f\x31\x01")
    call("PATCH", path, {"state": "cancelled"})
    problem = check_problem(call("GET", path + "/picture.exr"), 409, "unfinished")
    assert problem["detail"] == ("the job was cancelled at 0.0 %; there is no finished picture")


@pytest.mark.parametrize("option", ["--listen", "--http"])
@pytest.mark.parametrize("text", ["foo", "127.0.0.1", "127.0.0.1:", ":80", "127.0.0.1:70000", ""])
def test_address_without_port(tmp_path, option, text):
    done = subprocess.run([str(BIN / "tilery-master"), option, text, "--data",
                           str(tmp_path / "d")],
                          env=clean_env(), capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2 and f'{option} must be ADDR:PORT' in done.stderr, done.stderr
    assert f'"{text}"' in done.stderr and "reached from" not in done.stderr


def test_type_of_a_problem_leads_to_its_text(farm, call):
    problem = call("GET", "/api/v1/jobs/j9999")[1]
    path, kind = problem["type"].split("#")
    status, content, headers = Client(farm)("GET", path)
    text = content.decode()
    assert status == 200 and headers["Content-Type"].startswith("text/html")
    assert f'<h3 id="{kind}">{kind}</h3>' in text
    ids = re.findall(r"^### (.*)$", (ROOT / "docs/ERRORS.md").read_text(), re.M)
    assert re.findall(r'<h3 id="([^"]*)">', text) == ids


# --- Refusals ---------------------------------------------------------------------------------


def test_host_and_origin(farm, call):
    name = hashlib.sha256(b"").hexdigest()
    body = {"sha256": [name]}
    for host in ("evil.example", "evil.example:8080", "127.0.0.1.evil.example", "10.0.0.5"):
        check_problem(call("GET", "/api/v1/farm", headers={"Host": host}), 421, "unknown-host")
    for host in ("localhost", "localhost:1234", farm.http, "[::1]:80"):
        assert call("GET", "/api/v1/farm", headers={"Host": host})[0] == 200
    for origin in ("http://evil.example", "null", "http://localhost:1"):
        check_problem(call("POST", "/api/v1/chunks/missing", body, {"Origin": origin}), 403,
                      "foreign-origin")
    assert call("POST", "/api/v1/chunks/missing", body, {"Origin": farm.url})[0] == 200


def test_body_limits(farm):
    call = Client(farm)
    check_problem(call("POST", "/api/v1/jobs", b" " * ((16 << 20) + 1)), 413, "too-large")
    check_problem(Client(farm)("POST", "/api/v1/session", b"x" * (2 << 20)), 413, "too-large")


def test_methods_and_paths(call):
    check_problem(call("DELETE", "/api/v1/jobs"), 405, "method-not-allowed")
    check_problem(call("POST", "/healthz"), 405, "method-not-allowed")
    for path, allowed in (("/healthz", "GET, HEAD, OPTIONS"),
                          ("/api/v1/jobs", "POST, GET, HEAD, OPTIONS"),
                          ("/api/v1/jobs/j1", "GET, HEAD, PATCH, OPTIONS"),
                          ("/api/v1/chunks/" + "0" * 64, "PUT, OPTIONS")):
        assert call("TRACE", path)[2]["Allow"] == allowed, path
        status, content, headers = call("OPTIONS", path)
        assert (status, content, headers["Allow"]) == (204, b"", allowed), path
    check_problem(call("OPTIONS", "/api/v1/job"), 404, "unknown-path")
    for path in ("/api/v1/job", "/api/v2/jobs", "/api/v1/jobs/", "/api/v1/jobs/j1/x", "//", "/..",
                 "/api/v1/jobs/" + "j" * 200):
        check_problem(call("GET", path), 404, "unknown-path")
    status, content, headers = call("HEAD", "/healthz")
    assert status == 200 and not content and headers["Content-Length"] == "12"


def test_headers_of_the_page(call):
    status, content, headers = call("GET", "/")
    assert status == 200 and b"<title>Tilery</title>" in content
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "script-src 'self'" in policy
    assert "unsafe" not in policy and "frame-ancestors 'none'" in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Opener-Policy"] == "same-origin"
    for path in ("/app.js", "/viewer.js"):
        script = call("GET", path)[1]
        assert b"innerHTML" not in script and b"textContent" in script
    assert b"<script>" not in content and b"style=" not in content
    assert call("GET", "/style.css")[2]["Content-Type"].startswith("text/css")


def test_token(tmp_path):
    with Farm(tmp_path, token=TOKEN) as made:
        bare, good, bad = Client(made), Client(made, TOKEN), Client(made, TOKEN + "x")
        for path in ("/api/v1/farm", "/api/v1/jobs", "/metrics", "/api/v1/events"):
            reply = bare("GET", path)
            check_problem(reply, 401, "bad-token")
            assert reply[2]["WWW-Authenticate"].startswith("Bearer")
            check_problem(bad("GET", path), 401, "bad-token")
        assert bare("GET", "/healthz")[0] == bare("GET", "/")[0] == 200
        assert good("GET", "/api/v1/farm")[0] == 200
        check_problem(bare("POST", "/api/v1/session", {"token": "wrong"}), 401, "bad-token")
        status, _, headers = bare("POST", "/api/v1/session", {"token": TOKEN})
        cookie = headers["Set-Cookie"]
        assert status == 200 and "HttpOnly" in cookie and "SameSite=Strict" in cookie
        assert TOKEN not in cookie
        cookie = cookie.split(";")[0]
        assert bare("GET", "/api/v1/farm", headers={"Cookie": cookie})[0] == 200
        assert bare("GET", "/api/v1/farm", headers={"Cookie": "tilery=x"})[0] == 401
        assert TOKEN not in made.master.log()


# --- Description and metrics --------------------------------------------------------------------


def test_every_route_of_the_description_answers(call):
    for path, operations in OPENAPI["paths"].items():
        for method, operation in operations.items():
            real = path.replace("{id}", "j999").replace("{sha256}", "ab" * 32)
            if path == "/api/v1/events":
                real += "?job=j999"
            body = None if method == "get" else b"{}"
            status, content, _ = call(method.upper(), real, body)
            assert str(status) in operation["responses"], (method, path, status)
            assert not (status == 404 and "unknown-path" in str(content)), path
            assert operation["operationId"]


def test_description_is_served_and_whole(call):
    assert call("GET", "/api/v1/openapi.json")[1] == OPENAPI
    names = set(OPENAPI["components"]["schemas"])
    used = set(re.findall(r"#/components/schemas/(\w+)", json.dumps(OPENAPI)))
    assert used <= names
    for schema in OPENAPI["components"]["schemas"].values():
        assert set(schema.get("required", [])) <= set(schema.get("properties", {}))
    ids = [o["operationId"] for p in OPENAPI["paths"].values() for o in p.values()]
    assert len(ids) == len(set(ids))


def test_routes_of_the_program_are_described():
    source = (ROOT / "master/http.c").read_text()
    routes = re.findall(r'\{"(GET|POST|PUT|PATCH|DELETE)", "([^"]+)"', source)
    assert len(routes) > 15
    described = {(m.upper(), re.sub(r"\{\w+\}", "{}", p))
                 for p, o in OPENAPI["paths"].items() for m in o}
    page = {("GET", "/"), ("GET", "/app.js"), ("GET", "/viewer.js"), ("GET", "/icon.svg"),
            ("GET", "/style.css"), ("GET", "/docs/errors")}
    assert set(routes) - page == described


def test_metrics(call):
    status, content, headers = call("GET", "/metrics")
    assert status == 200 and headers["Content-Type"].startswith("text/plain")
    text = content.decode()
    typed = set(re.findall(r"^# TYPE (\S+) (?:counter|gauge)$", text, re.M))
    for line in text.splitlines():
        if not line.startswith("#"):
            name, value = re.fullmatch(r"(\w+)(?:\{[^}]*\})? (\S+)", line).groups()
            float(value)
            assert name in typed, name
            assert name.endswith("_total") == (f"# TYPE {name} counter" in text)
    assert 'tilery_jobs{state="queued"}' in text


# --- Events -----------------------------------------------------------------------------------


class Events:
    """A reader of the event stream."""

    def __init__(self, farm, query="", last=None):
        host, port = farm.http.split(":")
        self.connection = http.client.HTTPConnection(host, int(port), timeout=20 * SLOW)
        self.connection.request("GET", "/api/v1/events" + query,
                                headers={"Last-Event-ID": last} if last else {})
        self.reply = self.connection.getresponse()
        assert self.reply.status == 200
        assert self.reply.headers["Content-Type"] == "text/event-stream"

    def next(self):
        event = {}
        while True:
            line = self.reply.readline().decode().rstrip("\n")
            assert line or event or self.reply.fp, "the stream ended"
            if not line and "event" in event:
                event["data"] = json.loads(event["data"])
                return event
            if line and not line.startswith(":"):
                key, value = line.split(": ", 1)
                event[key] = value

    def until(self, kind, condition=lambda data: True):
        while True:
            event = self.next()
            if event["event"] == kind and condition(event["data"]):
                return event


def test_events(farm, call, job):
    events = Events(farm)
    hello = events.next()
    assert hello["event"] == "hello" and hello["retry"] == "1000"
    made = call("POST", "/api/v1/jobs", job)[1]["id"]
    event = events.until("job", lambda d: d["id"] == made)
    needed = OPENAPI["components"]["schemas"]["JobEvent"]["required"]
    assert set(event["data"]) == set(needed)
    assert event["data"]["state"] == "queued"
    call("PATCH", f"/api/v1/jobs/{made}", {"state": "cancelled"})
    assert events.until("log", lambda d: d["job"] == made)["data"]["line"] == "cancelled"
    last = events.until("job", lambda d: d["state"] == "cancelled" and d["id"] == made)
    # A reader that comes back is told what it missed, and no more.
    again = Events(farm, last=event["id"])
    assert again.next()["event"] == "hello"
    replayed = []
    while not replayed or replayed[-1]["id"] != last["id"]:
        replayed.append(again.next())
    assert [e["id"] for e in replayed] == sorted({e["id"] for e in replayed},
                                                 key=lambda i: int(i.split("-")[1]))
    assert event["id"] not in [e["id"] for e in replayed]
    # One of another life of the master must read the lists again.
    other = Events(farm, last="1-1")
    assert other.next()["event"] == "hello" and other.next()["event"] == "reset"


def test_events_of_one_job(farm, call, job):
    first, second = (call("POST", "/api/v1/jobs", job)[1]["id"] for _ in range(2))
    events = Events(farm, f"?job={second}")
    assert events.next()["event"] == "hello"
    call("PATCH", f"/api/v1/jobs/{first}", {"state": "cancelled"})
    call("PATCH", f"/api/v1/jobs/{second}", {"state": "cancelled"})
    event = events.next()
    while event["data"].get("state") != "cancelled":
        assert second in (event["data"].get("id"), event["data"].get("job"))
        event = events.next()
    assert event["data"]["id"] == second
    check_problem(call("GET", "/api/v1/events?job=j9999"), 404, "unknown-job")


def test_rate_from_the_first_result_on(tmp_path):
    """The rays a second of a fresh master's first job. It said a thousandth of them until it had
    run for four seconds."""
    with Farm(tmp_path) as made:
        made.worker()
        job = made.submit(SEED_SCENE, "--spp", 24 if SLOW == 1 else 6)
        events = Events(made, f"?job={job}")
        rates = []
        while True:
            event = events.next()
            if event["event"] == "job" and event["data"]["done"] > 0.2:
                rates.append(event["data"]["rays_s"])
                if event["data"]["done"] == 1:
                    break
        report = made.wait_job(job)
        true = report["rays"] / report["seconds"]["render"]
        told = [rate for rate in rates if rate > 0]
        assert told and all(true / 8 < rate < true * 8 for rate in told), (true, rates)


def test_many_readers_do_not_slow_the_master(farm, call, job):
    readers = [Events(farm) for _ in range(50)]
    for _ in range(20):
        made = call("POST", "/api/v1/jobs", job)[1]["id"]
        call("PATCH", f"/api/v1/jobs/{made}", {"state": "cancelled"})
    for reader in readers:
        reader.until("job", lambda d: d["id"] == made and d["state"] == "cancelled")


# --- Restart and retention -----------------------------------------------------------------------


def test_jobs_survive_a_kill(tmp_path):
    with Farm(tmp_path) as made:
        ids = [made.submit(SEED_SCENE, "--spp", 4, "--size", "64x64", "--name", f"n{i}")
               for i in range(4)]
        call = Client(made)
        body = {k: made.job(ids[0])[k] for k in ("package", "spec")}
        keyed = call("POST", "/api/v1/jobs", body, {"Idempotency-Key": "k"})[1]["id"]
        for name, change in ((ids[1], {"state": "cancelled"}), (ids[2], {"state": "paused"}),
                             (ids[3], {"priority": 5})):
            assert made.request("PATCH", f"/api/v1/jobs/{name}", change)[0] == 200
        made.kill_master()
        made.start_master()
        assert [made.job(i)["state"] for i in ids] == ["queued", "cancelled", "paused", "queued"]
        assert made.job(ids[3])["priority"] == 5 and made.job(ids[0])["name"] == "n0"
        assert made.job(ids[1])["events"][-1]["text"] == "cancelled"
        again = Client(made)("POST", "/api/v1/jobs", body, {"Idempotency-Key": "k"})
        assert again[0] == 201 and again[1]["id"] == keyed
        # Ids are never given twice.
        assert int(made.submit(SEED_SCENE, "--spp", 4, "--size", "64x64")[1:]) > int(keyed[1:])


def test_retention(tmp_path):
    with Farm(tmp_path, master_arguments=["--retention", "0.00002"]) as made:
        made.worker()
        job = made.submit(SEED_SCENE, "--spp", 1, "--size", "16x16")
        wait_until(lambda: made.request("GET", f"/api/v1/jobs/{job}")[0] == 404, "the job to go")
        wait_until(lambda: not list((made.data / "jobs").iterdir()), "its files to go")
        # Nobody else needs its scene.
        wait_until(lambda: not [p for p in (made.data / "chunks").rglob("*") if p.is_file()],
                   "its chunks to go")
        made.kill_master()
        made.start_master()
        assert made.submit(SEED_SCENE, "--spp", 1, "--size", "16x16") != job


def test_chunks_of_kept_jobs_stay(tmp_path):
    """Only what no job needs goes: the scene of a paused job is there when it goes on, although
    chunks of ended jobs are swept meanwhile."""
    with Farm(tmp_path, master_arguments=["--retention", "0.00002"]) as made:
        kept = made.submit(GLASS_SCENE, "--spp", 1, "--size", "16x16")
        assert made.request("PATCH", f"/api/v1/jobs/{kept}", {"state": "paused"})[0] == 200
        files = {p for p in (made.data / "chunks").rglob("*") if p.is_file()}
        made.worker()
        gone = made.submit(SEED_SCENE, "--spp", 1, "--size", "16x16")
        more = {p for p in (made.data / "chunks").rglob("*") if p.is_file()}
        assert more > files
        wait_until(lambda: made.request("GET", f"/api/v1/jobs/{gone}")[0] == 404, "the job to go")
        wait_until(lambda: {p for p in (made.data / "chunks").rglob("*") if p.is_file()} == files,
                   "its own chunks to go")
        made.kill_master()
        made.start_master()
        time.sleep(3)  # some sweeps more
        assert {p for p in (made.data / "chunks").rglob("*") if p.is_file()} == files
        assert made.request("PATCH", f"/api/v1/jobs/{kept}", {"state": "queued"})[0] == 200
        made.wait_job(kept)


def test_picture_after_a_restart(tmp_path):
    """The finished picture comes from the checkpoint, the same bytes as before."""
    with Farm(tmp_path) as made:
        made.worker()
        job = made.submit(GLASS_SCENE, "--spp", 4, "--size", "64x64")
        before = made.wait_job(job)
        picture = made.request("GET", f"/api/v1/jobs/{job}/picture.exr", raw=True)
        # The row of a finished job is stored before the checkpoint; done is told a little sooner.
        wait_until((made.data / "jobs" / job.removeprefix("j") / "film").exists, "the checkpoint")
        made.kill_master()
        made.start_master()
        assert made.job(job)["image_sha256"] == before["image_sha256"]
        again = made.request("GET", f"/api/v1/jobs/{job}/picture.exr", raw=True)
        assert picture[0] == again[0] == 200 and picture[1] == again[1]
        for name in ("error", "samples", "rays", "units", "seconds", "spp_mean"):
            assert made.job(job)[name] == before[name], name


# --- Clients that misbehave ----------------------------------------------------------------------


def test_connections_that_say_nothing(farm, call):
    """Many idle or half-spoken connections leave the master as quick as it was."""
    import socket
    host, port = farm.http.split(":")
    idle = []
    for i in range(200):
        s = socket.create_connection((host, int(port)))
        s.sendall([b"", b"GET", b"POST /api/v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n{",
                   b"\x00\xff" * 50][i % 4])
        idle.append(s)
    begin = time.monotonic()
    for _ in range(20):
        assert call("GET", "/api/v1/farm")[0] == 200
    assert time.monotonic() - begin < 2 * SLOW
    for s in idle:
        s.close()
    assert call("GET", "/healthz")[0] == 200


@pytest.mark.parametrize("said", [
    [b"", b"GET / HT"],
    [b"POST /api/v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 900000\r\n\r\n{"],
    [b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n"]],
    ids=["nothing", "half-a-body", "events"])
def test_strangers_keep_nobody_out(tmp_path, said):
    """More connections than there may be, all of which ask nothing, send a body byte by byte, or
    listen: whoever asks is answered.

    They kept the master's 1,000 connections for as long as they liked, and everybody out.
    """
    import resource
    import socket
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 3000)), hard))
    idle = []
    try:
        with Farm(tmp_path) as made:
            host, port = made.http.split(":")
            for i in range(1300):
                idle.append(socket.create_connection((host, int(port)), timeout=10))
                idle[-1].sendall(said[i % len(said)])
                if b"events" in said[0]:
                    assert idle[-1].recv(1), "it listens"
            begin = time.monotonic()
            for _ in range(3):
                for s in idle:
                    with contextlib.suppress(OSError):  # it was hung up on
                        s.send(b" ")  # it goes on, which counts for nothing
                assert Client(made)("GET", "/healthz")[0] == 200
            assert time.monotonic() - begin < 2 * SLOW
            assert tilery("jobs", env=made.env()).returncode == 0
    finally:
        for s in idle:
            s.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.parametrize("head", [
    "Host: localhost\r\nHost: evil.example\r\nContent-Length: 5\r\n",
    "Host: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n",
    "Host: localhost\r\nContent-Length: 5\r\nContent-Length: 60\r\n"])
def test_request_of_two_readings(farm, head):
    """What a proxy in front may read another way is refused, and nothing is read after it."""
    import socket
    host, port = farm.http.split(":")
    with socket.create_connection((host, int(port)), timeout=10 * SLOW) as s:
        s.sendall(f"POST /api/v1/chunks/missing HTTP/1.1\r\n{head}\r\n".encode() + b"0\r\n\r\n"
                  + b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20)
        answers = b""
        try:
            while data := s.recv(65536):
                answers += data
        except ConnectionResetError:
            pass
    assert answers.startswith(b"HTTP/1.1 400 "), answers
    assert answers.count(b"HTTP/1.1 ") == 1, answers


def test_client_that_leaves_while_it_waits(farm, job):
    import socket
    host, port = farm.http.split(":")
    body = json.dumps(job).encode()
    for _ in range(30):
        s = socket.create_connection((host, int(port)))
        s.sendall(b"POST /api/v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: "
                  + str(len(body)).encode() + b"\r\n\r\n" + body)
        s.close()
    assert Client(farm)("GET", "/healthz")[0] == 200
