"""The page as people see it: each state of it, in Debian's Chromium."""
import os
import pathlib
import re
import sys

import pytest
from playwright.sync_api import expect, sync_playwright

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
from farm import SEED_SCENE, Farm  # noqa: E402

SMALL = ("--spp", 4, "--size", "96x64")
LONG = ("--spp", 100000, "--size", "256x256")
PATIENCE_MS = 60000  # for what a busy machine delays; nothing here is measured


@pytest.fixture(scope="module", name="browser")
def launch():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(name="page")
def make_page(browser, request):
    """A page whose script has never failed: errors of it fail the test."""
    page = browser.new_page(viewport={"width": 1280, "height": 860})
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    errors = []
    page.on("pageerror", lambda e: errors.append(str(e)))
    yield page
    folder = os.environ.get("TILERY_WEB_PICTURES")
    if folder:
        page.screenshot(path=pathlib.Path(folder) / f"{request.node.name}.png", full_page=True)
    page.close()
    assert not errors


@pytest.fixture(name="farm")
def make_farm(tmp_path):
    with Farm(tmp_path) as farm:
        yield farm


def test_empty(farm, page):
    page.goto(farm.url)
    expect(page.locator("#commands")).to_contain_text(f"TILERY_MASTER={farm.url}")
    expect(page.locator("#worker-command")).to_have_text(f"tilery-worker --master {farm.listen}")
    assert page.title() == "Tilery"


def test_job_from_queue_to_picture_without_a_reload(farm, page):
    page.goto(farm.url)
    job = farm.submit(SEED_SCENE, *SMALL, "--name", "<b>bold</b>")
    row = page.locator("#jobs tr", has_text=job)
    expect(row).to_contain_text("queued")
    expect(page.locator("#jobs")).to_contain_text("<b>bold</b>")  # as text, never as markup
    assert page.locator("#jobs b").count() == 0
    farm.worker(name="alpha")
    expect(row).to_contain_text("done")
    expect(page.locator("#workers")).to_contain_text("alpha")
    page.goto(f"{farm.url}/#{job}")
    expect(page.locator("#picture")).to_have_attribute("alt", re.compile("100 %"))
    width = page.evaluate("document.getElementById('picture').naturalWidth")
    assert width == 96
    expect(page.locator("#report")).to_contain_text(farm.job(job)["image_sha256"])
    error = farm.job(job)["error"]
    told = page.evaluate(  # as JavaScript writes numbers
        "e => 'relMSE' + e.relmse.toPrecision(3) + ' (95 %: ' + e.relmse_low.toPrecision(3) + ' to '"
        " + e.relmse_high.toPrecision(3) + ')'", error)
    expect(page.locator("#report")).to_contain_text(told)
    with page.expect_download() as download:
        page.locator("#exr").click()
    assert pathlib.Path(download.value.path()).read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_crop_tells_pixels_of_the_full_picture(farm, page):
    farm.worker()
    job = farm.submit(SEED_SCENE, *SMALL, "--crop", "32,16,40,24")
    farm.wait_job(job)
    page.goto(f"{farm.url}/#{job}")
    expect(page.locator("#picture")).to_have_attribute("alt", re.compile("100 %"))
    page.locator("#actual").click()
    expect(page.locator("#zoom")).to_have_text("100 %")
    box = page.locator("#picture").bounding_box()
    page.mouse.move(box["x"] + 5.5, box["y"] + 7.5)
    expect(page.locator("#place")).to_have_text("pixel 37,23")


def test_zoom_and_keys(farm, page):
    farm.worker()
    jobs = [farm.submit(SEED_SCENE, *SMALL, "--seed", i) for i in range(3)]
    for job in jobs:
        farm.wait_job(job)
    page.goto(f"{farm.url}/#{jobs[2]}")
    expect(page.locator("#picture")).to_have_attribute("alt", re.compile("100 %"))
    page.keyboard.press("1")
    expect(page.locator("#zoom")).to_have_text("100 %")
    page.keyboard.press("+")
    expect(page.locator("#zoom")).to_have_text("150 %")
    page.keyboard.press("j")
    expect(page.locator("#job-title")).to_contain_text(jobs[1])
    page.keyboard.press("k")
    expect(page.locator("#job-title")).to_contain_text(jobs[2])
    page.keyboard.press("/")
    page.keyboard.type("j1")  # typed, not taken for keys
    expect(page.locator("#jobs tr")).to_have_count(1)
    expect(page.locator("#job-title")).to_contain_text(jobs[2])
    page.keyboard.press("Escape")  # empties the field: all are listed again
    expect(page.locator("#jobs tr")).to_have_count(3)
    page.keyboard.press("?")
    expect(page.locator("#help")).to_be_visible()
    page.locator("#keys-on").uncheck()
    page.locator("#help button").click()
    page.keyboard.press("j")
    expect(page.locator("#job-title")).to_contain_text(jobs[2])


def test_pause_resume_and_cancel_that_asks(farm, page):
    farm.worker()
    job = farm.submit(SEED_SCENE, *LONG)
    page.goto(f"{farm.url}/#{job}")
    line = page.locator("#job-line")
    expect(line).to_contain_text("rendering")
    page.get_by_role("button", name="Pause").click()
    expect(line).to_contain_text("paused")
    page.get_by_role("button", name="Resume").click()
    expect(line).not_to_contain_text("paused")
    page.once("dialog", lambda d: d.dismiss())
    page.get_by_role("button", name="Cancel").click()
    assert farm.job(job)["state"] != "cancelled"
    page.once("dialog", lambda d: d.accept())
    page.get_by_role("button", name="Cancel").click()
    expect(line).to_contain_text("cancelled")
    expect(page.get_by_role("button", name="Retry")).to_be_visible()


def test_master_gone_and_back(farm, page):
    farm.worker()
    job = farm.submit(SEED_SCENE, *SMALL)
    farm.wait_job(job)
    page.goto(f"{farm.url}/#{job}")
    expect(page.locator("#picture")).to_have_attribute("alt", re.compile("100 %"))
    farm.kill_master()
    expect(page.locator("#offline")).to_contain_text("No answer since")
    assert page.evaluate("document.getElementById('picture').naturalWidth") == 96  # it stays
    farm.start_master()
    expect(page.locator("#offline")).to_be_hidden()


def test_token(tmp_path, page):
    with Farm(tmp_path, token="a-long-token") as farm:
        page.goto(farm.url)
        page.locator("#token").fill("wrong")
        page.get_by_role("button", name="Show the farm").click()
        expect(page.locator("#login-note")).to_contain_text("not this farm's token")
        page.locator("#token").fill("a-long-token")
        page.get_by_role("button", name="Show the farm").click()
        expect(page.locator("#farm")).to_contain_text("0 workers")
        cookies = page.context.cookies()
        assert [c["httpOnly"] for c in cookies if c["name"] == "tilery"] == [True]
        assert "a-long-token" not in str(cookies) + page.url


def test_narrow_and_dark(farm, page):
    """Nothing is wider than a phone, whatever the theme."""
    farm.worker()
    farm.wait_job(farm.submit(SEED_SCENE, *SMALL))
    page.set_viewport_size({"width": 390, "height": 800})
    page.emulate_media(color_scheme="dark")
    page.goto(farm.url)
    expect(page.locator("#job")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
