"""The vendor's Python SDK as a client of `robot serve`: scripts/check_go2 runs it.

    sdk.py crc                  the vendor's checksums of filled frames, and that of a state in CDR, which unit tests in src/message.rs have
    sdk.py stand [--seconds S]  release the mode, stand up, hold: as the SDK's own example for the Go2 does
"""
import argparse
import json
import time

from unitree_sdk2py.comm.motion_switcher.motion_switcher_client import MotionSwitcherClient
from unitree_sdk2py.core.channel import ChannelFactoryInitialize, ChannelPublisher, ChannelSubscriber
from unitree_sdk2py.idl.default import unitree_go_msg_dds__LowCmd_, unitree_go_msg_dds__LowState_
from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.go2.sport.sport_client import SportClient
from unitree_sdk2py.utils.crc import CRC

POS_STOP, VEL_STOP = 2.146e9, 16000.0
LYING = [0.0, 1.36, -2.65] * 4
STANDING = [0.0, 0.67, -1.3] * 4
RISE_S = 1.0


def words(seed):
    """The same stream of words as `fill` in src/message.rs."""
    x = (seed * 2654435761 & 0xFFFFFFFF) ^ 0x9E3779B9
    while True:
        x = (x * 1664525 + 1013904223) & 0xFFFFFFFF
        y = x ^ (x >> 15)
        yield y & 0x7F7F7F7F if seed % 2 == 0 else y


KINDS = {
    "uint8": lambda x: x & 0xFF,
    "uint16": lambda x: x & 0xFFFF,
    "int16": lambda x: ((x & 0xFFFF) ^ 0x8000) - 0x8000,
    "uint32": lambda x: x,
    "int32": lambda x: (x ^ 0x80000000) - 0x80000000,
    "float32": lambda x: (((x ^ 0x80000000) - 0x80000000) >> 8) / 256.0,
}


def fill(frame, stream):
    """Fills every field of a message in order."""
    for name, hint in type(frame).__annotations__.items():
        value = getattr(frame, name)
        many = isinstance(value, (list, tuple))
        if hasattr((value[0] if many else value), "__idl_typename__"):
            for item in value if many else [value]:
                fill(item, stream)
            continue
        kind = next(KINDS[k] for k in sorted(KINDS, key=len, reverse=True) if f"'{k}'" in str(hint))
        setattr(frame, name, [kind(next(stream)) for _ in value] if many else kind(next(stream)))
    return frame


def print_crc():
    crc = CRC()
    for seed in (0, 2, 4):
        cmd = crc.Crc(fill(unitree_go_msg_dds__LowCmd_(), words(seed)))
        state = crc.Crc(fill(unitree_go_msg_dds__LowState_(), words(seed)))
        cdr = 0xCBF29CE484222325
        for byte in fill(unitree_go_msg_dds__LowState_(), words(seed)).serialize():
            cdr = (cdr ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
        print(f"{seed} {cmd:08x} {state:08x} {cdr:016x}")


def stand(seconds):
    """Prints one JSON object: states seen, gaps between them, joint errors at the end."""
    crc, states = CRC(), {"count": 0, "bad_crc": 0, "latest": None, "gaps": 0, "first_s": None}
    begin = time.monotonic()

    def on_state(message):
        if states["first_s"] is None:
            states["first_s"] = time.monotonic() - begin
        elif message.tick != states["latest"].tick + 2:
            states["gaps"] += 1
        if states["count"] % 50 == 0 and crc.Crc(message) != message.crc:
            states["bad_crc"] += 1
        states["count"] += 1
        states["latest"] = message

    subscriber = ChannelSubscriber("rt/lowstate", LowState_)
    subscriber.Init(on_state, 10)
    publisher = ChannelPublisher("rt/lowcmd", LowCmd_)
    publisher.Init()
    switcher = MotionSwitcherClient()
    switcher.SetTimeout(5.0)
    switcher.Init()
    sport = SportClient()
    sport.SetTimeout(5.0)
    sport.Init()
    modes = []
    for _ in range(5):
        _, result = switcher.CheckMode()
        modes.append(result["name"] if result else None)
        if result and not result["name"]:
            break
        lies = sport.StandDown()
        switcher.ReleaseMode()
    while states["latest"] is None:
        time.sleep(0.002)

    cmd = unitree_go_msg_dds__LowCmd_()
    cmd.head[0], cmd.head[1], cmd.level_flag, cmd.gpio = 0xFE, 0xEF, 0xFF, 0
    for motor in cmd.motor_cmd:
        motor.mode, motor.q, motor.dq, motor.kp, motor.kd, motor.tau = 0x01, POS_STOP, VEL_STOP, 0, 0, 0
    start = [states["latest"].motor_state[i].q for i in range(12)]
    commands, due, from_s = 0, time.monotonic(), time.monotonic()
    while (t := time.monotonic() - from_s) < seconds:
        lying, standing = min(t / RISE_S, 1.0), min(max(t / RISE_S - 1.0, 0.0), 1.0)
        for i in range(12):
            folded = (1 - lying) * start[i] + lying * LYING[i]
            motor = cmd.motor_cmd[i]
            motor.q, motor.dq, motor.kp, motor.kd = (1 - standing) * folded + standing * STANDING[i], 0.0, 60.0, 5.0
        cmd.crc = crc.Crc(cmd)
        publisher.Write(cmd)
        commands += 1
        due += 0.002
        time.sleep(max(0.0, due - time.monotonic()))
    latest = states.pop("latest")
    w, x, y, z = latest.imu_state.quaternion
    print(json.dumps({
        **states,
        "commands": commands,
        "modes": modes,
        "stand_down": lies,
        "joint_error_rad": max(abs(latest.motor_state[i].q - STANDING[i]) for i in range(12)),
        "upright": 1 - 2 * (x * x + y * y),
        "foot_force_n": sum(latest.foot_force),
    }))


def main():
    args = argparse.ArgumentParser()
    args.add_argument("what", choices=["crc", "stand"])
    args.add_argument("--domain", type=int, default=1)
    args.add_argument("--interface", default="lo")
    args.add_argument("--seconds", type=float, default=10)
    args = args.parse_args()
    if args.what == "crc":
        return print_crc()
    ChannelFactoryInitialize(args.domain, args.interface)
    stand(args.seconds)


if __name__ == "__main__":
    main()
