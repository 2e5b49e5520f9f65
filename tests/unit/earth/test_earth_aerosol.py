import numpy as np
import pytest
from earth_forms import model_of, solar, thermal

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere import aerosol
from horizonval.earth.tables import json_object

Z = np.arange(0.0, 100_001.0, 100.0)
GREEN, WINDOW = solar(0.54, 0.56, nodes=1), thermal(10.7, 11.3)
MODELS = ("background", "volcanic_moderate", "volcanic_high", "polar", "dust")


def depth(name: str, wavelength_um: float = 0.55, above_m: float = 0.0, **amount: float) -> float:
    z = Z[above_m <= Z]
    return float(np.trapezoid(aerosol.aerosol(name, z, **amount).at(wavelength_um)[0], z))


@pytest.mark.parametrize(
    ("name", "total", "above_11_km"),
    # Optical depths of the LOWTRAN7 models up to 40 km, summed by trapezoids between their levels.
    [("background", 0.3303, 0.00697), ("volcanic_moderate", 0.3513, 0.02734), ("volcanic_high", 0.4195, 0.09557)],
)
def test_optical_depths_of_lowtran(name: str, total: float, above_11_km: float) -> None:
    levels = np.array([*range(26), 30, 35, 40]) * 1e3
    # by hand: logarithmic means of LOWTRAN7's levels from 0 to 10 km, (a - b) / ln(a / b)
    visibility_23_km = {"depth_below_10_km": 0.3156}
    at_levels = aerosol.aerosol(name, levels, **visibility_23_km).at(0.55)[0]
    assert np.trapezoid(at_levels, levels) == pytest.approx(total, rel=2e-4)
    assert np.trapezoid(at_levels[11:], levels[11:]) == pytest.approx(above_11_km, rel=5e-4)
    # Exponentials between the levels hold less than straight lines: 2 %.
    assert depth(name, **visibility_23_km) == pytest.approx(total, rel=0.025)
    assert depth(name, **visibility_23_km) < total
    assert depth(name, above_m=11e3) == pytest.approx(above_11_km, rel=0.025)


def test_the_background_is_the_mean_of_the_earth() -> None:
    """MODIS on Aqua (Remer et al. 2008): 0.13 over the sea, 0.19 over the 29 % that are land."""
    assert depth("background") == pytest.approx(0.71 * 0.13 + 0.29 * 0.19, abs=0.002)
    # CALIOP: 62 % (Gui et al. 2021) to 69 % (Bourgeois et al. 2018) in the boundary layer, of what the troposphere has
    below = depth("background") - depth("background", above_m=2e3)
    assert 0.60 < below / (depth("background") - depth("background", above_m=11e3)) < 0.70


@pytest.mark.parametrize("name", MODELS)
def test_the_amount_below_ten_kilometres_is_as_asked(name: str) -> None:
    for asked in (0.0, 0.05, 1.2):
        found = depth(name, depth_below_10_km=asked) - depth(name, above_m=10e3, depth_below_10_km=asked)
        # trapezoids of 100 m
        assert found == pytest.approx(asked, rel=1e-3)
    assert depth(name, above_m=11e3, depth_below_10_km=1.2) == depth(name, above_m=11e3)


def test_scenes_ask_for_an_amount() -> None:
    amounts = [{"aerosol_optical_depth_550nm": 1.0}, {"aerosol_optical_depth_550nm": 0.0}, {"aerosol": "none"}]
    hazy, thin, clear = (np.trapezoid(model_of(GREEN, atmosphere=a).nodes[0].particle_per_m, Z) for a in amounts)
    # 0.95 of it is scattered (rural air 0.946, tropospheric 0.964)
    assert hazy - thin == pytest.approx(0.952, abs=0.006)
    assert 0.006 < thin - clear < 0.009
    hazy, thin = (model_of(WINDOW, atmosphere=a).thermal[0].extinction_at([500.0]).sum() for a in amounts[:2])
    assert hazy > thin


@pytest.mark.parametrize(
    ("kind", "exponent", "exponent_blue", "albedo", "asymmetry"),
    # Angstrom exponents 550 to 1060 and 337 to 550 nm, single-scattering albedo and g at 550 nm.
    [
        ("rural_rh70", 1.316, 0.960, 0.9462, 0.664),
        ("tropospheric_rh70", 1.579, 1.042, 0.9635, 0.651),
        ("background_stratospheric", 1.826, 1.113, 1.0, 0.685),
        ("aged_volcanic", 0.967, 0.338, 0.9473, 0.698),
        ("meteoric_dust", 0.313, 0.105, 0.9949, 0.691),
        # by hand from the desert model's block data for 10 m/s
        ("desert_wind_10", 0.892, 0.755, 0.9289, 0.6919),
    ],
)
def test_spectra(kind: str, exponent: float, exponent_blue: float, albedo: float, asymmetry: float) -> None:
    blue, green, red = 0.3371, 0.55, 1.06
    found = aerosol.optics(kind, [blue, green, red])
    ratio = np.log(found.extinction)
    assert (ratio[1] - ratio[2]) / np.log(red / green) == pytest.approx(exponent, abs=1e-3)
    assert (ratio[0] - ratio[1]) / np.log(green / blue) == pytest.approx(exponent_blue, abs=1e-3)
    assert found.extinction[1] == pytest.approx(1.0, abs=1e-12)
    assert found.scattering[1] == pytest.approx(albedo, abs=1e-4)
    assert found.asymmetry[1] == pytest.approx(asymmetry, abs=5e-4)


@pytest.mark.parametrize("kind", json_object("aerosol.json")["spectra"])
def test_spectra_are_possible_everywhere(kind: str) -> None:
    found = aerosol.optics(kind, np.geomspace(0.2, 18.5, 5000))
    assert (found.scattering >= 0).all()
    assert (found.scattering <= found.extinction).all()
    assert (np.abs(found.asymmetry) < 1).all()


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("wavelength_um", [0.35, 0.55, 0.9])
def test_no_steps_in_altitude(name: str, wavelength_um: float) -> None:
    z = np.arange(0.0, 100_000.0, 10.0)
    extinction, scattering, asymmetry = aerosol.aerosol(name, z).at(wavelength_um)
    # 10 m: the steepest level to level change (to 2 to 1 per km, or 6 to 1 at 20 km after an eruption) is 2 % per 10 m,
    # 2.7 % at the top of the dust (10 to 1 per km); a kind of particle gives way to the next over 1000 m.
    assert np.abs(np.diff(np.log(extinction))).max() < (0.028 if name == "dust" else 0.02)
    assert np.abs(np.diff(scattering / extinction)).max() < 0.002
    assert np.abs(np.diff(asymmetry)).max() < 0.002
    assert (scattering <= extinction).all()


def test_each_region_has_its_own_particles() -> None:
    heights = np.array([1.0, 5.0, 20.0, 60.0]) * 1e3
    for name, stratospheric in (("background", "background_stratospheric"), ("volcanic_high", "aged_volcanic")):
        extinction, scattering, asymmetry = aerosol.aerosol(name, heights).at(0.8)
        for i, kind in enumerate(("rural_rh70", "tropospheric_rh70", stratospheric, "meteoric_dust")):
            expected = aerosol.optics(kind, 0.8)
            assert scattering[i] / extinction[i] == pytest.approx(expected.scattering / expected.extinction, rel=1e-12)
            assert asymmetry[i] == pytest.approx(float(expected.asymmetry), rel=1e-12)


def test_polar_air_is_clean_and_its_stratosphere_low() -> None:
    """Of LOWTRAN7's fall and winter set: as much above 11 km as in spring and summer, but lower."""
    z = Z[Z >= 11e3]
    polar, background = (aerosol.aerosol(name, z).at(0.55)[0] for name in ("polar", "background"))
    assert depth("polar") < 0.45 * depth("background", depth_below_10_km=0.3156)
    assert np.average(z, weights=polar) < np.average(z, weights=background) - 500.0
    low = aerosol.aerosol("polar", np.array([9000.0])).at(0.8)
    assert low[2][0] == pytest.approx(float(aerosol.optics("background_stratospheric", 0.8).asymmetry), rel=1e-12)


def test_dust_fills_the_lowest_five_kilometres_evenly() -> None:
    dust, background = (aerosol.aerosol(name, Z).at(0.55)[0] for name in ("dust", "background"))
    np.testing.assert_allclose(dust[Z <= 5e3], 0.08e-3, rtol=1e-12)
    np.testing.assert_array_equal(dust[Z >= 11e3], background[Z >= 11e3])
    # coarse grains: less blue than haze, and absorbing in the window
    assert depth("dust", 0.87) / depth("dust") > 1.15 * depth("background", 0.87) / depth("background")
    assert depth("dust", 10.0) > 0.1


def test_asymmetry_of_a_mixture_is_weighted_with_what_scatters() -> None:
    mixture = aerosol.aerosol("volcanic_high", np.array([10_500.0]))
    _, _, asymmetry = mixture.at(1.5)
    share = mixture.extinction_550_per_m[:, 0]
    kinds = [aerosol.optics(kind, 1.5) for kind in mixture.kinds]
    assert np.count_nonzero(share) == 2
    weight = [s * float(k.scattering) for s, k in zip(share, kinds, strict=True)]
    expected = np.dot(weight, [float(k.asymmetry) for k in kinds]) / np.sum(weight)
    assert asymmetry[0] == pytest.approx(expected, rel=1e-12)


def test_none_and_above_the_top() -> None:
    extinction, scattering, asymmetry = aerosol.aerosol("none", Z).at(0.55)
    assert not extinction.any()
    assert not scattering.any()
    assert not asymmetry.any()
    assert aerosol.aerosol("background", np.array([100_001.0])).at(0.55)[0] == 0


def test_solar_nodes_hold_molecules_and_particles() -> None:
    clear, hazy = (model_of(GREEN, atmosphere={"aerosol": name}).nodes[0] for name in ("none", "volcanic_high"))
    extinction, scattering, asymmetry = aerosol.aerosol("volcanic_high", Z).at(hazy.wavelength_um)
    np.testing.assert_array_equal(hazy.molecular_per_m, clear.molecular_per_m)
    np.testing.assert_allclose(hazy.extinction_per_m - clear.extinction_per_m, extinction, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(hazy.particle_per_m, scattering, rtol=1e-12)
    np.testing.assert_allclose(hazy.asymmetry, asymmetry, rtol=1e-12)
    assert not clear.particle_per_m.any()
    assert (hazy.extinction_per_m >= hazy.scattering_per_m).all()


def test_particles_absorb_in_thermal_bands() -> None:
    (clear,), (hazy,) = (model_of(WINDOW, atmosphere={"aerosol": name}).thermal for name in ("none", "volcanic_high"))
    # Aged volcanic particles absorb 0.02513 of their extinction at 550 nm at 11 um; at 19 km that is 0.0153 per km.
    added = (hazy.extinction_at([19e3]) - clear.extinction_at([19e3])).ravel()
    np.testing.assert_allclose(added, 0.0153e-3 * 0.02513, rtol=0.02)
    # The tables of the particles end at 18.5 um.
    assert model_of(thermal(18.6, 19.5)).thermal


def test_bands_outside_the_spectra_are_refused() -> None:
    with pytest.raises(UserError, match=r'cam\.toml: band\[0\]: .*within 0\.2 to 18\.5 um.*aerosol = "none"'):
        model_of(solar(18.0, 19.0))
    assert model_of(solar(18.0, 19.0), atmosphere={"aerosol": "none"}).nodes
