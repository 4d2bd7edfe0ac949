"""The vendor's C++ SDK (with its own Cyclone DDS 0.10.2) as a client of `robot serve --released --domain 0`: stands up and holds.

Prints one JSON object. The SDK checks the checksum of every state itself and prints complaints."""
import json
import sys
import time

from unitree_interface import UnitreeInterface

LYING = [0.0, 1.36, -2.65] * 4
STANDING = [0.0, 0.67, -1.3] * 4


def main():
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    robot = UnitreeInterface.create_go2("lo")
    begin = time.monotonic()
    state = robot.read_low_state()
    while abs(state.imu.accel[2]) < 1.0:
        if time.monotonic() - begin > 10:
            sys.exit("no state within 10 s")
        time.sleep(0.002)
        state = robot.read_low_state()
    first_s = time.monotonic() - begin
    start = list(state.motor.q)
    command = robot.create_zero_command()
    commands, due, from_s = 0, time.monotonic(), time.monotonic()
    while (t := time.monotonic() - from_s) < seconds:
        lying, standing = min(t, 1.0), min(max(t - 1.0, 0.0), 1.0)
        command.q_target = [
            (1 - standing) * ((1 - lying) * start[i] + lying * LYING[i]) + standing * STANDING[i] for i in range(12)
        ]
        command.dq_target, command.tau_ff = [0.0] * 12, [0.0] * 12
        command.kp, command.kd = [60.0] * 12, [5.0] * 12
        robot.write_low_command(command)
        commands += 1
        due += 0.002
        time.sleep(max(0.0, due - time.monotonic()))
    state = robot.read_low_state()
    _, x, y, _ = state.imu.quat
    print(json.dumps({
        "first_s": first_s,
        "commands": commands,
        "joint_error_rad": max(abs(state.motor.q[i] - STANDING[i]) for i in range(12)),
        "upright": 1 - 2 * (x * x + y * y),
    }))


if __name__ == "__main__":
    main()
