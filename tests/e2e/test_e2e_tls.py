"""A farm under TLS: who is let in, who is turned away and told why, and that the bits are the same.

Authorities and certificates are made here with openssl (of ca-certificates).
"""
import http.client
import pathlib
import re
import signal
import socket
import ssl
import subprocess
import time

import pytest

from farm import SEED_SCENE, SLOW, Daemon, Farm, clean_env, report_of, tilery, wait_until
from scripted import Scripted
from wire_peer import frame

OPTIONS = ("--spp", 4, "--size", "64x64")


def openssl(*args):
    subprocess.run(["openssl", *map(str, args)], check=True, capture_output=True, timeout=60)


class Authority:
    """A certificate authority in a folder of its own."""

    def __init__(self, folder, name):
        self.folder, self.name = folder, name
        self.path = folder / f"{name}.pem"
        openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
                "-keyout", folder / f"{name}.key", "-out", self.path, "-days", "2",
                "-subj", f"/CN={name}")

    def issue(self, name, names="IP:127.0.0.1,DNS:localhost", days=1):
        """(certificate, key) of the authority; days < 0: expired."""
        base = self.folder / f"{self.name}-{name}"
        openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
                "-keyout", f"{base}.key", "-out", f"{base}.csr", "-subj", f"/CN={name}")
        pathlib.Path(f"{base}.ext").write_text(f"subjectAltName={names}\n")
        openssl("x509", "-req", "-in", f"{base}.csr", "-CA", self.path,
                "-CAkey", self.folder / f"{self.name}.key", "-CAcreateserial", "-days", days,
                "-extfile", f"{base}.ext", "-out", f"{base}.pem")
        return f"{base}.pem", f"{base}.key"


@pytest.fixture(scope="module", name="pki")
def make_pki(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pki")
    return Authority(folder, "farm"), Authority(folder, "stranger")


def master_files(pki, **kwargs):
    certificate, key = pki.issue("master", **kwargs)
    return ["--tls-cert", certificate, "--tls-key", key]


class TlsFarm(Farm):
    @property
    def url(self):
        return f"https://{self.http}"


def test_same_bits_over_tls_with_certificates_of_workers(tmp_path, pki):
    farm_pki, _ = pki
    alone = tmp_path / "alone.json"
    done = tilery("render", SEED_SCENE, *OPTIONS, "-o", tmp_path / "alone.exr", "--report", alone)
    assert done.returncode == 0, done.stderr
    arguments = master_files(farm_pki) + ["--tls-client-ca", farm_pki.path]
    certificate, key = farm_pki.issue("worker")
    with TlsFarm(tmp_path, token="a-long-token", master_arguments=arguments) as farm:
        trust = ["--tls-ca", farm_pki.path, "--tls-cert", certificate, "--tls-key", key]
        first = farm.worker(arguments=trust)
        farm.worker(arguments=trust)
        out, report = tmp_path / "out.exr", tmp_path / "report.json"
        done = farm.cli("submit", SEED_SCENE, *OPTIONS, "--wait", "-o", out, "--report", report,
                        env=farm.env(TILERY_TLS_CA=farm_pki.path))
        assert done.returncode == 0, done.stderr
        assert report_of(report)["image_sha256"] == report_of(alone)["image_sha256"]
        # The master dies and comes back: the worker returns, certificate and all.
        farm.kill_master()
        farm.start_master()
        env = farm.env(TILERY_TLS_CA=farm_pki.path)
        job = farm.cli("submit", SEED_SCENE, *OPTIONS, "--seed", 3, "--tls-ca", farm_pki.path).stdout
        assert farm.cli("watch", job.strip(), "--progress", "none", env=env).returncode == 0
        assert first.end() == 0


def test_worker_without_a_certificate_is_told_and_ends_with_4(tmp_path, pki):
    farm_pki, stranger = pki
    arguments = master_files(farm_pki) + ["--tls-client-ca", farm_pki.path]
    with TlsFarm(tmp_path, master_arguments=arguments) as farm:
        for trust in ([], ["--tls-cert", *[x for pair in zip(stranger.issue("worker"), ["--tls-key"])
                                           for x in pair], stranger.issue("worker")[1]]):
            worker = farm.worker(wait=False, arguments=["--tls-ca", farm_pki.path, *trust])
            assert worker.process.wait(20 * SLOW) == 4
            assert "[untrusted]" in worker.log() and "--tls-client-ca" in worker.log()


@pytest.mark.parametrize("case", ["stranger", "name", "expired"])
def test_master_that_is_not_trusted(tmp_path, pki, case):
    farm_pki, stranger = pki
    pki_of_master = stranger if case == "stranger" else farm_pki
    kwargs = {"names": "DNS:other.example"} if case == "name" else {}
    if case == "expired":
        kwargs["days"] = 0
    with TlsFarm(tmp_path, master_arguments=master_files(pki_of_master, **kwargs)) as farm:
        if case == "expired":
            time.sleep(1.2)  # days 0: valid for its first second
        worker = farm.worker(wait=False, arguments=["--tls-ca", farm_pki.path])
        assert worker.process.wait(20 * SLOW) == 4
        assert "[untrusted]" in worker.log()
        listed = farm.cli("jobs", env=farm.env(TILERY_TLS_CA=farm_pki.path))
        assert listed.returncode == 4 and "[untrusted]" in listed.stderr, listed.stderr
        assert "--tls-ca" in listed.stderr


def test_rude_and_plain_peers_do_no_harm(tmp_path, pki):
    farm_pki, _ = pki
    with TlsFarm(tmp_path, master_arguments=master_files(farm_pki)) as farm:
        plain = farm.worker(wait=False)
        for port in (farm.listen, farm.http):
            address = (port.split(":")[0], int(port.split(":")[1]))
            for data in (b"", b"\x16\x03\x01\xff\xff" + b"A" * 70000, b"GET / HTTP/1.1\r\n\r\n",
                         bytes(range(256)) * 300):
                with socket.create_connection(address, timeout=20 * SLOW) as rude:
                    try:
                        rude.sendall(data)
                    except ConnectionError:
                        pass
            # Half a handshake, then silence: others are served meanwhile.
            silent = socket.create_connection(address, timeout=20 * SLOW)
            silent.sendall(b"\x16\x03\x01\x02\x00\x01")
        farm.worker(arguments=["--tls-ca", farm_pki.path])
        done = farm.cli("submit", SEED_SCENE, *OPTIONS, "--wait", "-o", tmp_path / "o.exr",
                        "--tls-ca", farm_pki.path)
        assert done.returncode == 0, done.stderr
        assert plain.process.poll() is None and "cannot register" in plain.log()
        silent.close()


def test_last_words_of_many_are_heard(tmp_path, pki):
    """More frames than one turn takes, and a goodbye behind them, arrive with the end of TLS in one
    piece: the goodbye counts."""
    farm_pki, _ = pki
    with TlsFarm(tmp_path, master_arguments=master_files(farm_pki)) as farm:
        context = ssl.create_default_context(cafile=farm_pki.path)
        peer = Scripted(farm, hello=False)
        peer.sock = context.wrap_socket(peer.sock, server_hostname="127.0.0.1")
        peer.send("Hello", **peer.values)
        peer.welcome()
        farm.master.signal(signal.SIGSTOP)
        words = b"".join(frame("Heartbeat", sequence=i, sent_us=1) for i in range(150))
        peer.sock.sendall(words + frame("Goodbye", reason="done"))
        peer.sock.setblocking(False)
        with pytest.raises(ssl.SSLWantReadError):
            peer.sock.unwrap()  # says that nothing follows, and does not wait for the answer
        time.sleep(0.1)
        farm.master.signal(signal.SIGCONT)
        wait_until(lambda: re.search("workers (left|lost) id=w1", farm.master.log()),
                   "the worker to go")
        assert "workers left id=w1" in farm.master.log()
        peer.close()


def test_only_tls_13_and_a_secure_cookie(tmp_path, pki):
    farm_pki, _ = pki
    with TlsFarm(tmp_path, token="a-long-token", master_arguments=master_files(farm_pki)) as farm:
        host, port = farm.http.split(":")
        context = ssl.create_default_context(cafile=farm_pki.path)
        connection = http.client.HTTPSConnection(host, int(port), context=context, timeout=20 * SLOW)
        connection.request("POST", "/api/v1/session", body='{"token":"a-long-token"}',
                           headers={"Content-Type": "application/json",
                                    "Origin": f"https://{farm.http}"})
        reply = connection.getresponse()
        assert reply.status == 200 and "Secure" in reply.getheader("Set-Cookie")
        assert connection.sock.version() == "TLSv1.3"
        connection.close()
        context.maximum_version = ssl.TLSVersion.TLSv1_2
        for address in (farm.http, farm.listen):
            name, number = address.split(":")
            with pytest.raises((ssl.SSLError, ConnectionError)):
                with socket.create_connection((name, int(number)), timeout=20 * SLOW) as plain:
                    context.wrap_socket(plain, server_hostname=name).close()


def test_options_that_do_not_go_together(tmp_path, pki):
    farm_pki, stranger = pki
    certificate, key = farm_pki.issue("master")
    bad = tmp_path / "bad.pem"
    bad.write_text("no certificate\n")
    cases = [
        (["--tls-cert", certificate], "--tls-key is missing"),
        (["--tls-key", key], "--tls-cert is missing"),
        (["--tls-client-ca", farm_pki.path], "asks for TLS"),
        (["--tls-cert", bad, "--tls-key", key], "bad.pem"),
        (["--tls-cert", certificate, "--tls-key", stranger.issue("master")[1]], "key"),
        (["--tls-cert", certificate, "--tls-key", key, "--tls-client-ca", bad], "CA"),
        (["--tls-cert", "/nonexistent", "--tls-key", key], "/nonexistent"),
    ]
    for number, (arguments, said) in enumerate(cases):
        log = tmp_path / f"master{number}.log"
        master = Daemon("master", ["tilery-master", "--listen", "127.0.0.1:0", "--http",
                                   "127.0.0.1:0", "--data", tmp_path / "data", *arguments],
                        log, clean_env())
        assert master.process.wait(20 * SLOW) == 2, arguments
        assert said in log.read_text(), (arguments, log.read_text())
    for arguments, said in [(["--tls-cert", certificate], "--tls-key"),
                            (["--tls-ca", bad], "CA"), (["--tls-ca", "/nonexistent"], "CA")]:
        log = tmp_path / "worker.log"
        worker = Daemon("worker", ["tilery-worker", "--master", "127.0.0.1:1", *arguments], log,
                        clean_env())
        assert worker.process.wait(20 * SLOW) == 2, arguments
        assert said in log.read_text(), log.read_text()
