"""Physical truth: what the simulated devices really do, and where they crash."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable, Sequence
from random import Random

import pytest
from PIL import Image, ImageChops, ImageStat

from labos.core.wells import parse_well
from labos.node import Attachment, Crash, DeviceError, Node, Setup, World
from labos_drivers._optics import color_of
from labos_drivers.a4s_sealer import A4sSealer
from labos_drivers.barty import Barty
from labos_drivers.biometra import Biometra
from labos_drivers.brooks_peeler import BrooksPeeler
from labos_drivers.camera import Camera
from labos_drivers.camera.photo import TROUBLES, project, take_photo
from labos_drivers.camera.sketch import EMPTY_WELL, FOIL, NEST, centre_of, colors_of, draw_placement, sketch
from labos_drivers.chemspeed import Chemspeed
from labos_drivers.hidex import Hidex
from labos_drivers.inheco import Inheco
from labos_drivers.liconic import Liconic
from labos_drivers.mir import MiR
from labos_drivers.ot2 import OT2
from labos_drivers.ot2.simulator import OT2Simulator
from labos_drivers.pf400 import PF400
from labos_drivers.pipette import Pipette
from labos_drivers.platecrane import PlateCrane
from labos_drivers.sciclops import Sciclops
from labos_drivers.solo import Solo
from labos_drivers.tecan import Tecan
from labos_drivers.tecan.simulator import absorbance
from labos_drivers.ur import UR
from tests.drivers.conftest import Bench, lab_seconds


async def halfway(work: asyncio.Task[None], lab_s: float) -> None:
    """Let lab seconds pass, then switch the device off."""
    await asyncio.sleep(lab_s)
    work.cancel()
    with pytest.raises(asyncio.CancelledError):
        await work


# -- arms --------------------------------------------------------------------------------------


def test_an_arm_carries_a_plate_however_its_places_are_written(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400")
        (plate,) = world.stock("ot2.deck2", "plate")
        await arm.transfer("rpl/ot2.positions.deck2", "camera_module.plate_station", "wide", "narrow")
        assert world.list_contents() == {"camera_module.plate_station": [plate]}

    asyncio.run(body())


def test_an_arm_puts_a_plate_on_a_plate_and_crashes(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400")
        world.stock("a.nest", "plate")
        world.stock("b.nest", "plate")
        with pytest.raises(Crash, match="plate on a plate"):
            await arm.transfer("a.nest", "b.nest")
        assert (await arm.observe())["labware"] == {"gripper": True}

    asyncio.run(body())


def test_an_arm_grips_empty_air(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400")
        with pytest.raises(Crash, match="empty air"):
            await arm.transfer("a.nest", "b.nest")
        assert len(world.crashes()) == 1

    asyncio.run(body())


def test_waste_takes_any_number(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400", config={"waste": ["rpl/wc.bin"]})
        for chute in ("wc.bin", "wc.trash", "wc.bin"):
            world.stock("a.nest", "plate")
            await arm.transfer("a.nest", chute)
        assert world.list_contents() == {}
        assert len(world.motions("discard")) == 3

    asyncio.run(body())


def test_a_change_of_grip_goes_through_the_regrip_place(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400", regrip="rpl/wc.regrip")
        world.stock("a.nest", "plate")
        await arm.transfer("a.nest", "b.nest", "narrow", "wide")
        await arm.transfer("b.nest", "a.nest", "wide", "wide")
        assert [motion.place for motion in world.motions("release")] == ["wc.regrip", "b.nest", "a.nest"]

    asyncio.run(body())


@pytest.mark.parametrize(("driver", "transfer_s"), [(PF400, 30), (PlateCrane, 60), (UR, 45), (Sciclops, 40)])
def test_an_arm_switched_off_halfway_keeps_the_plate_in_its_hand(
    driver: type[PF400], transfer_s: float, bench: Bench, world: World
) -> None:
    async def body() -> None:
        arm = await bench.start(driver, "arm", pace=1)
        (plate,) = world.stock("a.nest", "plate")
        await halfway(asyncio.create_task(arm.transfer("a.nest", "b.nest")), 0.55 * transfer_s)
        assert world.list_contents() == {"hand:arm": [plate]}

        again = await bench.start(driver, "arm", pace=1)
        assert await again.is_idle()
        assert await again.observe() == {"labware": {"gripper": True}}
        await again.put_down("b.nest")
        assert world.list_contents() == {"b.nest": [plate]}
        assert await again.observe() == {"labware": {"gripper": False}}

    lab_seconds(body)


@pytest.mark.parametrize(("share", "where"), [(0.2, "a.nest"), (0.9, "b.nest")])
def test_an_arm_switched_off_early_or_late(share: float, where: str, bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400", pace=1)
        (plate,) = world.stock("a.nest", "plate")
        await halfway(asyncio.create_task(arm.transfer("a.nest", "b.nest")), share * 30)
        assert world.list_contents() == {where: [plate]}

    lab_seconds(body)


def test_a_stop_ends_the_motion_and_holds_until_reset(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400", pace=1)
        world.stock("a.nest", "plate")
        work = asyncio.create_task(arm.transfer("a.nest", "b.nest"))
        await asyncio.sleep(15)
        assert not await arm.is_idle()
        await arm.stop()
        with pytest.raises(DeviceError) as stopped:
            await work
        assert stopped.value.effects == "unknown"
        with pytest.raises(DeviceError) as refused:
            await arm.explore_workcell()
        assert refused.value.effects == "none"
        await arm.reset()
        await arm.put_down("b.nest")
        assert list(world.list_contents()) == ["b.nest"]

    lab_seconds(body)


def test_a_busy_device_refuses(bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(PF400, "pf400", pace=1)
        work = asyncio.create_task(arm.explore_workcell())
        await asyncio.sleep(1)
        with pytest.raises(DeviceError, match="busy"):
            await arm.explore_workcell()
        await work

    lab_seconds(body)


@pytest.mark.parametrize("driver", [PF400, PlateCrane])
def test_lids_come_off_and_go_on(driver: type[PF400], bench: Bench, world: World) -> None:
    async def body() -> None:
        arm = await bench.start(driver, "arm")
        (plate,) = world.stock("a.nest", "plate")
        (lid,) = world.stock(f"lid:{plate}", "lid")
        await arm.remove_lid("a.nest", "arm.LidNest1")
        assert world.at("arm.LidNest1") == [lid]
        with pytest.raises(Crash, match="empty air"):
            await arm.remove_lid("a.nest", "arm.LidNest2")
        await arm.replace_lid("arm.LidNest1", "a.nest")
        assert world.at(f"lid:{plate}") == [lid]
        with pytest.raises(Crash, match="not there"):
            await arm.replace_lid("arm.LidNest1", "b.nest")

    asyncio.run(body())


def test_the_stacker_takes_from_the_top_until_a_tower_is_empty(bench: Bench, world: World) -> None:
    async def body() -> None:
        stacker = await bench.start(Sciclops, "sciclops")
        plates = world.stock("sciclops.tower2", "plate", 2)
        await stacker.get_plate("tower2")
        assert world.at("sciclops.exchange") == [plates[1]]
        world.carry(plates[1], "")
        await stacker.get_plate("sciclops.tower2", "sciclops.exchange")
        with pytest.raises(DeviceError, match="tower2 is empty") as empty:
            await stacker.get_plate("tower2")
        assert empty.value.effects == "none"
        assert not world.crashes()

    asyncio.run(body())


def test_a_full_tower_crashes(bench: Bench, world: World) -> None:
    async def body() -> None:
        stacker = await bench.start(Sciclops, "sciclops")
        world.stock("sciclops.tower1", "plate", 20)
        world.stock("sciclops.exchange", "plate")
        with pytest.raises(Crash, match="plate on a plate"):
            await stacker.transfer("exchange", "tower1")

    asyncio.run(body())


def test_an_incubator_carries_to_its_slots_and_back(bench: Bench, world: World) -> None:
    async def body() -> None:
        incubator = await bench.start(Liconic, "liconic")
        (plate,) = world.stock("liconic.exchange", "plate")
        await incubator.load_plate(2, 7)
        assert world.list_contents() == {"liconic.stacker2_slot7": [plate]}
        world.stock("liconic.exchange", "plate")
        with pytest.raises(DeviceError, match="transfer station") as refused:
            await incubator.unload_plate(2, 7)
        assert refused.value.effects == "none"
        with pytest.raises(Crash, match="plate on a plate"):
            await incubator.load_plate(2, 7)
        assert await incubator.observe() == {
            "shaking": False,
            "labware": {"exchange": False, "gripper": True},
        }
        await incubator.put_down()
        await incubator.begin_shake()
        with pytest.raises(Crash, match="shakes"):
            await incubator.load_plate(1, 1)

    asyncio.run(body())


def test_an_incubator_takes_its_time_to_warm_up(bench: Bench) -> None:
    async def body() -> None:
        incubator = await bench.start(Liconic, "liconic", pace=1)
        await incubator.set_target_temp(37)
        assert await incubator.get_target_temp() == 37
        assert await incubator.get_current_temp() == 22
        await asyncio.sleep(600)
        assert 30 < await incubator.get_current_temp() < 33
        await asyncio.sleep(6000)
        assert await incubator.get_current_temp() == 37

    lab_seconds(body)


# -- sealing, peeling, cycling -----------------------------------------------------------------


def test_a_seal_goes_on_once_and_comes_off_once(bench: Bench, world: World) -> None:
    async def body() -> None:
        sealer = await bench.start(A4sSealer, "sealer")
        peeler = await bench.start(BrooksPeeler, "peeler")
        (plate,) = world.stock("sealer.default", "plate")
        await sealer.seal(3, 175)
        world.carry(plate, "peeler.default")
        assert await peeler.sealcheck() == "sealed"
        await peeler.peel()
        assert await peeler.sealcheck() == "unsealed"
        with pytest.raises(DeviceError, match="XPeel seal check 00") as bare:
            await peeler.peel()
        assert bare.value.effects == "none"
        assert not world.is_shut("peeler.default")
        world.carry(plate, "")
        assert await peeler.sealcheck() == "no plate"
        with pytest.raises(DeviceError, match="XPeel error 06"):
            await peeler.peel()
        assert not world.crashes()

    asyncio.run(body())


def test_sealing_nothing_a_sealed_or_a_lidded_plate_crashes(bench: Bench, world: World) -> None:
    async def body() -> None:
        sealer = await bench.start(A4sSealer, "sealer")
        with pytest.raises(Crash, match="not there"):
            await sealer.seal()
        (plate,) = world.stock("sealer.default", "plate")
        await sealer.seal()
        with pytest.raises(Crash, match="sealed plate"):
            await sealer.seal()
        world.carry(plate, "")
        (plate,) = world.stock("sealer.default", "plate")
        world.stock(f"lid:{plate}", "lid")
        with pytest.raises(Crash, match="seals a lid"):
            await sealer.seal()

    asyncio.run(body())


def test_a_hand_in_a_working_sealer_crashes_and_a_restart_opens_it(bench: Bench, world: World) -> None:
    async def body() -> None:
        sealer = await bench.start(A4sSealer, "sealer", pace=1)
        arm = await bench.start(PF400, "pf400")
        world.stock("sealer.default", "plate")
        work = asyncio.create_task(sealer.seal())
        await asyncio.sleep(2)
        with pytest.raises(Crash, match="closed gate"):
            await arm.transfer("sealer.default", "peeler.default")
        await halfway(work, 1)
        assert world.is_shut("sealer.default")
        await bench.start(A4sSealer, "sealer")
        await arm.transfer("sealer.default", "peeler.default")

    lab_seconds(body)


def test_a_cycler_keeps_hands_out_while_its_lid_is_closed(bench: Bench, world: World) -> None:
    async def body() -> None:
        cycler = await bench.start(Biometra, "biometra")
        arm = await bench.start(PF400, "pf400")
        world.stock("biometra.default", "plate")
        with pytest.raises(DeviceError, match="lid is open") as refused:
            await cycler.run_program(3)
        assert refused.value.effects == "none"
        await cycler.close_lid()
        await cycler.run_program(3)
        restarted = await bench.start(Biometra, "biometra")
        assert await restarted.observe() == {"lid": "closed"}
        with pytest.raises(Crash, match="closed gate"):
            await arm.transfer("biometra.default", "peeler.default")
        await restarted.open_lid()
        await arm.transfer("biometra.default", "peeler.default")

    asyncio.run(body())


def test_a_cycler_heats_no_empty_block(bench: Bench) -> None:
    async def body() -> None:
        cycler = await bench.start(Biometra, "biometra")
        await cycler.close_lid()
        with pytest.raises(Crash, match="not there"):
            await cycler.run_program(3)

    asyncio.run(body())


# -- liquid handlers and readers ---------------------------------------------------------------


def test_tips_and_bare_decks_seals_and_lids(bench: Bench, world: World) -> None:
    async def body() -> None:
        robot = await bench.start(OT2, "ot2")
        solo = await bench.start(Solo, "solo")
        for node in (robot, solo):
            with pytest.raises(Crash, match="into nothing"):
                await node.run_protocol("mix.yaml")
        (plate,) = world.stock("ot2.deck2", "plate")
        world.work("sealer", "seal", "ot2.deck2")
        with pytest.raises(Crash, match="into a seal"):
            await (await bench.start(OT2, "ot2")).run_protocol("mix.yaml")
        world.carry(plate, "")
        (plate,) = world.stock("solo.Position4", "plate")
        world.stock(f"lid:{plate}", "lid")
        with pytest.raises(Crash, match="into a lid"):
            await (await bench.start(Solo, "solo")).run_protocol("mix.hso")

    asyncio.run(body())


def test_a_liquid_handler_works_on_every_plate_and_keeps_hands_out(bench: Bench, world: World) -> None:
    async def body() -> None:
        robot = await bench.start(OT2, "ot2", pace=1)
        arm = await bench.start(PF400, "pf400")
        plates = world.stock("ot2.deck2", "plate") + world.stock("ot2.deck1_cooler", "plate")
        work = asyncio.create_task(
            robot.run_protocol("mix.yaml", color_A_volumes=[10.0], destination_wells=["A1"])
        )
        await asyncio.sleep(5)
        with pytest.raises(Crash, match="closed gate"):
            await arm.transfer("ot2.deck2", "b.nest")
        assert (await work)["status"] == "succeeded"
        pipetted = world.motions("pipette")
        assert {motion.plate for motion in pipetted} == set(plates)
        assert pipetted[0].facts["volumes"] == {"color_A": [10.0]}

    lab_seconds(body)


def test_a_camera_sees_what_is_there(bench: Bench, world: World) -> None:
    async def body() -> None:
        camera = await bench.start(Camera, "camera_module")
        assert await camera.observe() == {"labware": {"plate_station": False}}
        assert (await camera.grab_image("final_image.jpg")).name == "final_image.jpg"
        (plate,) = world.stock("camera_module.plate_station", "plate")
        assert (await camera.grab_image("a.jpg", save_location="runs")).name == "runs/a.jpg"
        assert await camera.observe() == {"labware": {"plate_station": True}}
        assert [motion.plate for motion in world.motions("picture")] == ["", plate]
        with pytest.raises(DeviceError, match="no known file type for pictures"):
            await camera.grab_image("a.doc")

    asyncio.run(body())


def test_readers_read_behind_a_closed_gate(bench: Bench, world: World) -> None:
    async def body() -> None:
        hidex = await bench.start(Hidex, "hidex")
        tecan = await bench.start(Tecan, "tecan")
        world.stock("hidex.default", "plate")
        world.stock("tecan.default", "plate")
        for read in (lambda: hidex.run_assay("OD"), lambda: tecan.measure_sample("ECP")):
            with pytest.raises(DeviceError, match="is open"):
                await read()
        await hidex.close_lid()
        await tecan.close_gate()
        assert await hidex.run_assay("OD") == "OD_0001.csv"
        assert (await tecan.measure_sample("ECP", tecan_iteration=2)).name == "tecan_2.asc"

    asyncio.run(body())


def test_a_synthesis_needs_a_closed_hood(bench: Bench, world: World) -> None:
    async def body() -> None:
        platform = await bench.start(Chemspeed, "chemspeed")
        with pytest.raises(DeviceError, match="lid is open"):
            await platform.run_program("closed_loop1")
        await platform.close_lid()
        await platform.run_program("closed_loop1")
        assert len(world.motions("synthesise")) == 1

    asyncio.run(body())


# -- the others --------------------------------------------------------------------------------


def test_pumps_spill_over_the_brim_and_remember(bench: Bench, world: World) -> None:
    async def body() -> None:
        barty = await bench.start(Barty, "barty")
        with pytest.raises(DeviceError, match="no pump 4"):
            await barty.fill([0, 4])
        await barty.fill_all(amount=60)
        await barty.refill_ink(["motor_1"], amount=5)
        again = await bench.start(Barty, "barty")
        assert again.device.tanks.reservoirs == {0: 65.0, 1: 60.0, 2: 60.0, 3: 60.0}
        await again.drain([1])
        with pytest.raises(Crash, match="spills"):
            await again.fill([0], amount=90)
        await again.drain_all()
        assert again.device.tanks.reservoirs == dict.fromkeys(range(4), 0.0)

    asyncio.run(body())


def test_a_base_is_out_of_reach_while_it_drives(bench: Bench, world: World) -> None:
    async def body() -> None:
        base = await bench.start(MiR, "mir", pace=1)
        arm = await bench.start(UR, "ur5")
        world.stock("mir.deck", "plate")
        work = asyncio.create_task(base.move("bio"))
        await asyncio.sleep(5)
        with pytest.raises(Crash, match="closed gate"):
            await arm.transfer("mir.deck", "a.nest")
        await work
        await base.dock("bio_dock")
        assert await base.observe() == {"position": "bio_dock"}
        assert await (await bench.start(MiR, "mir")).observe() == {"position": "bio_dock"}
        await arm.transfer("mir.deck", "a.nest")
        await arm.run_urp_program("wave.urp")

    lab_seconds(body)


# -- time --------------------------------------------------------------------------------------

Act = Callable[[Node], str]


@pytest.mark.parametrize(
    ("driver", "steps"),
    [
        (PF400, [("transfer", ("here.nest", "b.nest")), ("explore_workcell", ())]),
        (PlateCrane, [("transfer", ("here.nest", "b.nest"))]),
        (UR, [("transfer", ("here.nest", "b.nest")), ("run_urp_program", ("x.urp",))]),
        (Sciclops, [("home", ()), ("get_plate", ("here.nest",))]),
        (A4sSealer, [("seal", ())]),
        (BrooksPeeler, [("sealcheck", ())]),
        (Biometra, [("close_lid", ()), ("run_program", (3,)), ("open_lid", ())]),
        (Hidex, [("close_lid", ()), ("run_assay", ("OD",)), ("open_lid", ())]),
        (Inheco, [(name, ()) for name in ("open_door", "close_door", "begin_shake", "end_shake")]),
        (Pipette, [("initialise", ()), ("aspirate", (100.0,)), ("dispense", (100.0,))]),
        (Tecan, [("close_gate", ()), ("measure_sample", ()), ("open_gate", ())]),
        (Chemspeed, [("close_lid", ()), ("run_program", ("x",)), ("open_lid", ())]),
        (OT2, [("run_protocol", ("x.yaml",))]),
        (Solo, [("run_protocol", ("x.hso",))]),
        (Camera, [("grab_image", ())]),
        (MiR, [("move", ("a",)), ("dock", ("a",))]),
        (Barty, [("fill", ([0],)), ("fill_all", ()), ("drain", ([0],))]),
        (Liconic, [("load_plate", (1, 1)), ("unload_plate", (1, 1))]),
    ],
)
def test_actions_take_their_nominal_time_within_a_tenth(
    driver: type[Node], steps: list[tuple[str, tuple[object, ...]]], bench: Bench, world: World
) -> None:
    async def body() -> None:
        node = await bench.start(driver, "here", pace=10)
        for station in ("nest", "default", "deck2", "Position1", "exchange"):
            if (station, driver) != ("exchange", Sciclops):
                world.stock(f"here.{station}", "plate")
        loop = asyncio.get_running_loop()
        for name, args in steps:
            action = node.describe().action(name)
            assert action is not None
            started = loop.time()
            await getattr(node, name)(*args)
            took_s = (loop.time() - started) * 10
            assert 0.88 * action.duration_s < took_s < 1.12 * action.duration_s, name

    lab_seconds(body)


def test_the_same_seed_takes_the_same_time() -> None:
    def run(seed: int) -> float:
        world = World()

        async def body() -> float:
            arm = PF400(Setup(name="pf400", workcell="rpl", world=world, seed=seed))
            await arm.connect()
            await arm.explore_workcell()
            return asyncio.get_running_loop().time()

        took_s = lab_seconds(body)
        world.close()
        return took_s

    assert run(1) == run(1) != run(2)


# -- a whole route -----------------------------------------------------------------------------


def test_a_pcr_route_ends_in_the_waste_without_a_crash(bench: Bench, world: World) -> None:
    async def body() -> None:
        stacker = await bench.start(Sciclops, "sciclops")
        arm = await bench.start(PF400, "pf400", regrip="wc.regrip")
        robot = await bench.start(OT2, "ot2_pcr_alpha")
        sealer = await bench.start(A4sSealer, "sealer")
        cycler = await bench.start(Biometra, "biometra")
        peeler = await bench.start(BrooksPeeler, "peeler")
        camera = await bench.start(Camera, "camera_module")
        (plate,) = world.stock("sciclops.tower2", "plate")
        await stacker.get_plate("tower2")
        await arm.transfer("sciclops.exchange", "ot2_pcr_alpha.deck1_cooler", "narrow", "wide")
        await robot.run_protocol("mix.yaml")
        await arm.transfer("ot2_pcr_alpha.deck1_cooler", "sealer.default", "wide", "narrow")
        await sealer.seal(3, 175)
        await arm.transfer("sealer.default", "biometra.default", "narrow", "wide")
        await cycler.close_lid()
        await cycler.run_program(3)
        await cycler.open_lid()
        await arm.transfer("biometra.default", "peeler.default", "wide", "narrow")
        await peeler.peel()
        await arm.transfer("peeler.default", "camera_module.plate_station", "narrow", "narrow")
        await camera.grab_image("final_image.jpg")
        await arm.transfer("camera_module.plate_station", "wc.trash", "narrow", "narrow")
        done = [m.verb for m in world.motions() if m.plate == plate and m.verb not in ("grip", "release")]
        assert done == ["stock", "pipette", "seal", "heat", "cycle", "peel", "picture", "discard"]
        assert not world.crashes()

    asyncio.run(body())


def test_a_camera_reads_what_is_on_the_label(bench: Bench, world: World) -> None:
    async def body() -> None:
        camera = await bench.start(Camera, "camera")
        assert await camera.read_barcode() == {"barcode": ""}
        (plate,) = world.stock("camera.plate_station", "plate")
        assert await camera.read_barcode() == {"barcode": "LB000001"}
        world.label(plate, "new")
        assert await camera.read_barcode() == {"barcode": "new"}
        world.label(plate, "")
        assert await camera.read_barcode() == {"barcode": ""}

    asyncio.run(body())


def open_picture(taken: Attachment) -> Image.Image:
    assert isinstance(taken.content, bytes)
    return Image.open(io.BytesIO(taken.content)).convert("RGB")


def test_a_camera_shows_what_was_really_pipetted(bench: Bench, world: World) -> None:
    """Not what a driver was told: the robot's own protocol may have done something else."""

    async def body() -> None:
        camera = await bench.start(Camera, "camera")
        place = "camera.plate_station"
        assert is_like(find_seen_color(open_picture(await camera.grab_image("n.png")), "A1"), NEST)
        (plate,) = world.stock(place, "plate96")
        world.work("ot2", "pipette", place, volumes={"color_A": [275.0, 0.0]}, wells=["C5", "A1"])
        world.work("ot2", "pipette", place, volumes={"blue": [137.5]}, wells=["H12"])
        assert {well: tuple(map(round, color)) for well, color in colors_of(world, plate).items()} == {
            "C5": (203, 32, 51),
            "H12": (96, 128, 241),
        }
        image = open_picture(await camera.grab_image("n.png"))
        for well, color in (("C5", (203, 32, 51)), ("H12", (96, 128, 241)), ("B1", EMPTY_WELL)):
            assert is_like(find_seen_color(image, well), color), well
        turned = open_picture(await camera.grab_image("n.png", rotation=90))
        assert turned.size == image.size[::-1]
        world.work("sealer", "seal", place)
        assert is_like(find_seen_color(open_picture(await camera.grab_image("n.png")), "C5"), FOIL)

    asyncio.run(body())


def test_the_dyes_of_a_well_take_light_away_one_after_the_other() -> None:
    """By the law of Beer and Lambert: what two let through is the product of what each does."""
    one, other = {"color_A": 100.0}, {"color_C": 60.0, "water": 80.0}
    apart = zip(color_of(one), color_of(other), color_of(one | other), strict=True)
    assert all(a * b / 255 == pytest.approx(both) for a, b, both in apart)
    assert color_of({"water": 200.0}) == (255.0, 255.0, 255.0)


def test_an_ot2_takes_time_for_each_volume_if_it_is_told_how_long(world: World) -> None:
    def nominal_s(volumes: dict[str, list[float]], **config: float) -> float:
        return OT2Simulator(Setup("ot2", "rpl", world=world, config=config))._nominal_s(volumes)

    volumes = {"color_A": [20.0, 0.0], "color_B": [30.0, 40.0]}
    assert nominal_s(volumes) == nominal_s({}, dose_s=12) == 600
    assert nominal_s(volumes, dose_s=12) == 45 + 3 * 12


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_picture_may_be_bad(trouble: str, world: World) -> None:
    (plate,) = world.stock("camera.plate_station", "plate96")
    good = take_photo(sketch(world, plate), Random(1))
    bad = take_photo(sketch(world, plate, draw_placement(Random(2), trouble)), Random(1), trouble)
    apart = ImageChops.difference(good, bad)
    assert ImageStat.Stat(apart.convert("L")).mean[0] > 4


def find_seen_color(image: Image.Image, well: str) -> tuple[float, ...]:
    """What is in the picture where the middle of a well should be."""
    x, y = project(centre_of(*parse_well(well)), image.size)
    return tuple(ImageStat.Stat(image.crop((round(x) - 2, round(y) - 2, round(x) + 3, round(y) + 3))).mean)


def is_like(seen: Sequence[float], real: Sequence[float]) -> bool:
    """But for the light, which is warm, and less than full."""
    return all(0.7 * was - 4 <= now <= was + 4 for now, was in zip(seen, real, strict=True))


def test_readers_measure_what_was_really_pipetted(bench: Bench, world: World) -> None:
    async def body() -> None:
        hidex = await bench.start(Hidex, "hidex")
        world.stock("hidex.default", "plate96")
        await hidex.close_lid()
        full, half = {"color_B": [200.0, 100.0]}, {"A1": 100.0}
        world.work("ot2", "pipette", "hidex.default", volumes=full, wells=["A1", "A2"])
        first = (await hidex.read_plate("OD620"))["wells"]
        assert first["A1"] - 0.04 == pytest.approx(2 * (first["A2"] - 0.04), abs=0.05)
        assert first["A1"] > first["A3"] + 0.3
        assert first["A3"] == pytest.approx(0.04, abs=0.03)
        world.work("ot2", "pipette", "hidex.default", drawn=half)
        drawn = (await hidex.read_plate("OD620"))["wells"]
        assert drawn["A1"] == pytest.approx(first["A2"], abs=0.05)
        (plate,) = world.at("hidex.default")
        seen = [absorbance(plate, well, 620.0, world.contents(plate)) for well in ("A1", "A2", "A3")]
        assert seen == pytest.approx([drawn[well] for well in ("A1", "A2", "A3")], abs=0.03)

    asyncio.run(body())


def test_what_a_protocol_pours_and_draws_is_in_the_wells(bench: Bench, world: World) -> None:
    async def body() -> None:
        ot2 = await bench.start(OT2, "ot2")
        (plate,) = world.stock("ot2.deck2", "plate96")
        pours = {
            "red_volumes": [100.0, 50.0],
            "blue_volumes": [100.0, 0.0],
            "destination_wells": ["A1", "A2"],
        }
        await ot2.run_protocol("mix", **pours, source_wells=["A1"], source_volumes=[50.0])
        assert world.contents(plate) == {"A1": {"red": 75.0, "blue": 75.0}, "A2": {"red": 50.0, "blue": 0.0}}

    asyncio.run(body())


def test_a_reader_knows_its_plates(bench: Bench, world: World) -> None:
    async def body() -> None:
        hidex = await bench.start(Hidex, "hidex")
        (plate,) = world.stock("hidex.default", "plate384")
        await hidex.close_lid()
        first, second = await hidex.read_plate("OD"), await hidex.read_plate("OD")
        assert len(first["wells"]) == 384
        assert "P24" in first["wells"]
        assert [first["quantity"], first["unit"], second["file"]] == ["absorbance", "OD", "OD_0002.csv"]
        apart = [abs(value - second["wells"][well]) for well, value in first["wells"].items()]
        assert 0 < max(apart) < 0.1
        assert [motion.plate for motion in world.motions("read")] == [plate, plate]

    asyncio.run(body())
