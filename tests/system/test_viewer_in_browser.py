"""The report in a browser: it asks for nothing, complains of nothing, and viewer, cards and tables do what they say."""

from __future__ import annotations

import dataclasses
import math
import re
import threading

import numpy as np
import pytest
import synthetic
from browser import Browser, chromium_path
from scipy import constants, integrate
from synthetic import synthetic_cases, toy_image, write_run

from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.horizon import signed_limb_angle
from horizonval.report import build, build_report, campaign, view_server, viewer

pytestmark = pytest.mark.skipif(
    chromium_path() is None, reason="no Chromium on this machine (Debian: apt install chromium)"
)

READY = """new Promise(done => {
  const look = () => { const c = document.getElementById('v-frame');
    if (c.dataset.ready === document.getElementById('v-scrub').value) done(); else setTimeout(look, 10); };
  look(); })"""
PICTURE = "document.getElementById('v-frame').toDataURL()"
NAME = "document.getElementById('v-name').textContent"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The folder of a report with the page of a campaign."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "is_due", lambda run: True)
        return build_report(write_run(tmp_path_factory.mktemp("viewer") / "run")).parent


@pytest.fixture(scope="module")
def page(pages):
    return (pages / "index.html").as_uri()


@pytest.fixture(scope="module")
def campaign_page(pages):
    return pages / campaign.PAGE


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """A page of three of eight frames, one of them with numbers, and the address of a server of it."""
    run = write_run(tmp_path_factory.mktemp("long") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "MOST_CASES_SHOWN", 3)
        patch.setattr(viewer, "numbered_frames", lambda images: {0})
        page = build_report(run)
    server = view_server._server(view_server.viewable(run), 0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield page, f"http://127.0.0.1:{server.server_address[1]}/report/index.html?token={server.secret}"
    server.shutdown()
    thread.join(10)
    server.server_close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def visit(browser: Browser, address: str) -> None:
    # A change of the hash alone loads nothing.
    browser.open("about:blank")
    browser.requests.clear()
    browser.complaints.clear()
    browser.open(address)
    browser.evaluate(READY)


def point_at(browser: Browser, x: float, y: float) -> tuple[float, float]:
    """Put the pointer on a place of the canvas, given in shares of its size; returns that place on the screen."""
    left, top, width, height = browser.evaluate(
        "(() => { const c = document.getElementById('v-frame'); c.scrollIntoView({block: 'center'});"
        "const b = c.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; })()"
    )
    at = (left + x * width, top + y * height)
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=at[0], y=at[1])
    return at


def read_value(browser: Browser) -> tuple[int, int, int]:
    """The pixel and the number that the viewer says."""
    words = browser.evaluate("document.getElementById('v-value').textContent")
    x, y, value = map(int, re.match(r"x (\d+), y (\d+): (\d+) DN", words).groups())
    return x, y, value


def assert_stored(browser: Browser, case: int, *places: tuple[float, float]) -> None:
    """The numbers under the pointer are those of the image."""
    dn = toy_image(synthetic_cases()[case].truth).dn
    for place in places:
        point_at(browser, *place)
        x, y, value = read_value(browser)
        assert value == dn[y, x]


def test_pages_ask_for_nothing_and_fit(browser, page, campaign_page, tmp_path):
    for address in (campaign_page.as_uri(), page):
        assert browser.faults(address) == []
    # The frame is on the first screen.
    assert browser.evaluate("document.getElementById('v-frame').getBoundingClientRect().top") < 800
    # The probe would see it.
    (tmp_path / "bad.html").write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('no'); f()</script>")
    assert len(browser.faults((tmp_path / "bad.html").as_uri(), [1400])) >= 4


def test_the_value_under_the_pointer_is_the_stored_number_where_the_canvas_shows_it(browser, page):
    visit(browser, page)
    canvas = "[0, 1].map(i => document.getElementById('v-frame')[['clientWidth', 'clientHeight'][i]])"
    for place in ((0.5, 0.5), (0.45, 0.2), (0.52, 0.83), (0.6, 0.66)):
        assert_stored(browser, 0, place)
        width, height = browser.evaluate(canvas)
        scale = min(width / 640, height / 480)
        expected = ((place[0] - 0.5) * width / scale + 319.5, (place[1] - 0.5) * height / scale + 239.5)
        np.testing.assert_allclose(read_value(browser)[:2], expected, atol=0.51)


def test_direction_and_light_are_those_of_the_truth(browser, page):
    truths = [case.truth for case in synthetic_cases()]
    visit(browser, page)
    sides = set()
    for place in ((0.5, 0.5), (0.45, 0.2), (0.52, 0.83)):
        point_at(browser, *place)
        x, y, _ = read_value(browser)
        words = browser.evaluate("document.getElementById('v-value').textContent")
        axis, height, side = re.search(r"([\d.]+)° from the axis, ([\d.]+)° (above|below) the true", words).groups()
        d = unproject(truths[0].camera_model, (x, y))
        assert float(axis) == pytest.approx(math.degrees(math.acos(d[2])), abs=2e-3)
        # The nearest point of the horizon is not straight above or below, but a millionth of a turn aside.
        inside = signed_limb_angle(rotate(inverse(truths[0].q_cam_from_itrs), d), truths[0].r_itrs)
        signed = float(height) if side == "above" else -float(height)
        assert signed == pytest.approx(-math.degrees(float(inside)), abs=5e-3)
        sides.add(side)
    assert sides == {"above", "below"}
    shown = "[...document.querySelectorAll('#v-line i')].map(cell => Number(cell.style.getPropertyValue('--sun')))"
    expected = [math.acos(truth.sun_cam[2] / math.hypot(*truth.sun_cam)) / math.pi for truth in truths]
    np.testing.assert_allclose(browser.evaluate(shown), expected, atol=1e-4)


def test_keys_scrub_and_zoom(browser, page):
    visit(browser, page)
    assert "1 of 8: day-arc" in browser.evaluate(NAME)
    first = browser.evaluate(PICTURE)
    browser.press("ArrowRight")
    browser.evaluate(READY)
    assert "2 of 8: day-tilted" in browser.evaluate(NAME)
    second = browser.evaluate(PICTURE)
    assert second != first
    browser.press("+")
    assert browser.evaluate(PICTURE) != second
    browser.press("0")
    assert browser.evaluate(PICTURE) == second
    browser.evaluate("{const s = document.getElementById('v-scrub'); s.value = 3; s.dispatchEvent(new Event('input'))}")
    browser.evaluate(READY)
    assert "4 of 8: night" in browser.evaluate(NAME)
    light = "[...document.querySelectorAll('#v-line i')].map(cell => cell.className.split(' ')[0])"
    assert browser.evaluate(light) == ["day", "day", "sun", "eclipse", "day", "day", "day", "day"]


def test_no_value_is_read_before_the_frame_is_there(browser, page):
    visit(browser, page)
    x, y = point_at(browser, 0.5, 0.5)
    # Within one turn of the page's loop: the next frame is chosen, its numbers are not unpacked yet.
    words = browser.evaluate(
        f"""(() => {{ const move = () => document.getElementById('v-frame').dispatchEvent(
            new PointerEvent('pointermove', {{clientX: {x}, clientY: {y}}}));
          move(); const before = document.getElementById('v-value').textContent;
          const s = document.getElementById('v-scrub'); s.value = 1; s.dispatchEvent(new Event('input')); move();
          return [before, document.getElementById('v-value').textContent]; }})()"""
    )
    assert "DN of 1023" in words[0]
    assert words[1] == ""
    browser.evaluate(READY)
    assert_stored(browser, 1, (0.5, 0.5))


def test_two_estimators_and_the_truth_are_drawn_over_frame_and_cards(browser, page):
    visit(browser, page)
    drawn = "[...document.querySelectorAll('.tile:first-child svg.image path')].map(path => path.className.baseVal)"
    assert browser.evaluate(drawn) == ["limb", "points", "truth"]
    pictures = {browser.evaluate(PICTURE)}
    for key in ("t", "p", "l"):
        browser.press(key)
        pictures.add(browser.evaluate(PICTURE))
    assert len(pictures) == 4
    assert browser.evaluate(drawn) == []
    for key in ("t", "p", "l"):
        browser.press(key)
    alone = browser.evaluate(PICTURE)
    browser.choose("v-b", "ideal")
    assert browser.evaluate(PICTURE) != alone
    assert browser.evaluate("document.getElementById('v-scores').tBodies[0].rows.length") == 2
    curves = "document.querySelector('.tile svg.image').innerHTML"
    before = browser.evaluate(curves)
    browser.choose("v-a", "ideal")
    assert browser.evaluate(curves) != before


def test_an_address_brings_everything_back(browser, page):
    visit(browser, page + "#frame=1&a=ideal&b=altitude-free&zoom=4&x=300.0&y=200.0&off=p")
    shown, picture = browser.evaluate(NAME), browser.evaluate(PICTURE)
    assert "day-tilted" in shown
    assert browser.evaluate("['v-a', 'v-b'].map(id => document.getElementById(id).value)") == ["ideal", "altitude-free"]
    assert not browser.evaluate("document.getElementById('v-points').checked")
    browser.press("+")
    browser.press("-")
    address = browser.evaluate("location.href")
    visit(browser, address)
    assert browser.evaluate(NAME) == shown
    assert browser.evaluate(PICTURE) == picture
    visit(browser, page + "#night")
    assert "night" in browser.evaluate(NAME)


def test_tables_sort_and_what_has_no_number_stands_last_either_way_up(browser, page):
    visit(browser, page)
    names = "[...document.querySelectorAll('.outcomes tbody tr')].map(row => row.cells[0].textContent)"
    browser.click("document.querySelector('.outcomes thead th button')")
    up = browser.evaluate(names)
    browser.click("document.querySelector('.outcomes thead th button')")
    assert up == sorted(up)
    assert browser.evaluate(names) == up[::-1] != up
    column = "[...document.querySelectorAll('.outcomes tbody tr')].map(row => row.cells[9].textContent[0] === '–')"
    for _ in range(2):
        browser.click("document.querySelectorAll('.outcomes thead th button')[9]")
        assert browser.evaluate(column) == [False, False, True, True]


def test_cards_are_chosen_sorted_and_lead_to_the_viewer(browser, page):
    visit(browser, page)
    shown = "[...document.querySelectorAll('#grid .tile:not([hidden]) h3')].map(h => h.textContent)"
    assert len(browser.evaluate(shown)) == 8
    browser.choose("status", "valid")
    assert browser.evaluate(shown) == ["day-arc", "day-tilted", "lwir-arc"]
    browser.choose("camera", "lwir-160x120")
    assert browser.evaluate(shown) == ["lwir-arc"]
    assert browser.evaluate("document.getElementById('count').textContent") == "1 of 8 shown"
    browser.choose("status", "false")
    assert browser.evaluate(shown) == []
    assert browser.evaluate("!document.getElementById('nothing').hidden")
    for select in ("status", "camera"):
        browser.choose(select, "")
    browser.choose("order", "worst")
    assert browser.evaluate(shown)[:2] == ["sun-in-frame", "day-tilted"]
    browser.click("document.querySelector('.tile .open')")
    browser.evaluate(READY)
    assert browser.evaluate(NAME).endswith("sun-in-frame")
    assert browser.complaints == []


def test_the_keyboard_alone_moves_and_reads(browser, page):
    dn = toy_image(synthetic_cases()[0].truth).dn
    visit(browser, page + "#frame=0&zoom=4&x=300&y=240")
    before = browser.evaluate(PICTURE)
    browser.press("ArrowDown", shift=True)
    assert browser.evaluate(PICTURE) != before
    x, y, value = read_value(browser)
    assert x == 300
    assert y > 240
    assert value == dn[y, x]
    assert "1 of 8" in browser.evaluate(NAME)


def test_an_address_that_is_none_of_ours_shows_the_first_frame(browser, page):
    for tail in ("#50%", "#no-such-frame", "#frame=-3&zoom=x&x=&y=1", "#frame=1e9&x=1e9&y=-1e9"):
        visit(browser, page + tail)
        assert browser.complaints == []
        last = "1e9" in tail
        assert browser.evaluate(NAME).startswith("8 of 8" if last else "1 of 8")


def test_dark_where_the_reader_wants_it(browser, page):
    back = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)"
    visit(browser, page)
    assert min(browser.evaluate(back)) > 200
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    assert max(browser.evaluate(back)) < 60
    # Paper is white whatever the screen is.
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    browser.call("Emulation.setEmulatedMedia", media="print", features=dark)
    ink = "getComputedStyle(document.querySelector('header .verdict ~ p')).color.match(/\\d+/g).slice(0, 3).map(Number)"
    assert max(browser.evaluate(ink)) < 60
    browser.call("Emulation.setEmulatedMedia", media="", features=[])


def test_a_server_has_the_frames_that_the_page_leaves_out(browser, long_run):
    page, address = long_run
    visit(browser, page.as_uri() + "#frame=1")
    assert " of 3: " in browser.evaluate(NAME)
    assert "not in the page" in browser.evaluate("document.getElementById('v-value').textContent")
    for index in (0, 2, 5):
        name = synthetic_cases()[index].truth.scene["scene"]["name"]
        visit(browser, f"{address}#case={name}")
        assert browser.evaluate(NAME) == f"{index + 1} of 8: {name}"
        assert browser.complaints == []
        assert_stored(browser, index, (0.5, 0.5), (0.52, 0.7))
    assert browser.evaluate("document.querySelectorAll('#v-line i').length") == 8


def test_the_page_of_a_campaign_has_its_worst_frames(browser, campaign_page):
    visit(browser, campaign_page.as_uri())
    names = "[...document.querySelectorAll('script.v-data')].map(text => JSON.parse(text.textContent).name)"
    assert browser.evaluate(names) == [case.truth.scene["scene"]["name"] for case in synthetic_cases()]
    assert_stored(browser, 0, (0.5, 0.7))


def test_a_thermal_frame_says_what_a_black_body_would_have_to_be(browser, tmp_path, monkeypatch):
    def warm(truth):
        image = toy_image(truth)
        return dataclasses.replace(image, observation={"radiance_at_zero": 0.0, "radiance_per_dn": 0.15})

    monkeypatch.setattr(synthetic, "toy_image", warm)
    case = next(case for case in synthetic_cases() if case.truth.scene["scene"]["name"] == "lwir-arc")
    visit(browser, build_report(write_run(tmp_path / "run", [case])).as_uri())
    for place in ((0.5, 0.3), (0.5, 0.8)):
        point_at(browser, *place)
        words = browser.evaluate("document.getElementById('v-value').textContent")
        dn, radiance, kelvin = map(float, re.search(r": (\d+) DN.*\n(\S+) W m-2 sr-1, (\S+) K", words).groups())
        assert radiance == pytest.approx(0.15 * dn, rel=1e-4)

        def emitted(wavelength_m, temperature_k=kelvin):
            exponent = constants.h * constants.c / (wavelength_m * constants.k * temperature_k)
            return 2 * constants.h * constants.c**2 / wavelength_m**5 / np.expm1(exponent)

        # A hundredth of a kelvin is 1.6e-4 of the radiance of a body of 300 K, and more of colder ones.
        assert integrate.quad(emitted, 8e-6, 14e-6)[0] == pytest.approx(radiance, rel=5e-4)
