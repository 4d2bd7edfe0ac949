//! The usual mistakes between a policy and a robot, and how to undo each of them in a log.

use supple::robot::{GRAVITY_M_S2, JOINTS, Joints, joint_names};

use crate::bridge::log::Row;

/// A usual mistake: its name, and how to undo it in a row.
pub struct Mistake {
    pub text: String,
    pub undo: Box<dyn Fn(&mut Row)>,
}

fn mistake(text: impl Into<String>, undo: impl Fn(&mut Row) + 'static) -> Mistake {
    Mistake { text: text.into(), undo: Box::new(undo) }
}

/// Orders of joints that other programs use: where each of our joints is in theirs.
pub fn orders() -> Vec<(&'static str, [usize; JOINTS])> {
    let legs = |order: [usize; 4]| -> [usize; JOINTS] { std::array::from_fn(|joint| 3 * order[joint / 3] + joint % 3) };
    let by_type =
        |order: [usize; 4]| -> [usize; JOINTS] { std::array::from_fn(|joint| 4 * (joint % 3) + order[joint / 3]) };
    vec![
        ("FL, FR, RL, RR (left legs first, as Isaac has them)", legs([1, 0, 3, 2])),
        ("RR, RL, FR, FL (rear legs first)", legs([2, 3, 0, 1])),
        ("FL, RL, FR, RR", legs([2, 0, 3, 1])),
        ("all hips, all thighs, all calves, of FL, FR, RL, RR (as Isaac Lab has them)", by_type([1, 0, 3, 2])),
        ("all hips, all thighs, all calves, of FR, FL, RR, RL", by_type([0, 1, 2, 3])),
    ]
}

/// Returns the values of our joints from those in another order.
pub fn permuted(values: &Joints, order: &[usize; JOINTS]) -> Joints {
    std::array::from_fn(|joint| values[order[joint]])
}

/// Returns all mistakes that are tried.
pub fn mistakes() -> Vec<Mistake> {
    let mut all = Vec::new();
    for (name, order) in orders() {
        let readings = move |row: &mut Row| {
            let [q, dq, tau] = [&row.q, &row.dq, &row.tau].map(|values| permuted(values, &order));
            (row.q, row.dq, row.tau) = (q, dq, tau);
        };
        let targets = move |row: &mut Row| row.target = permuted(&row.target, &order);
        all.push(mistake(format!("the readings of the joints are in the order {name}"), readings));
        all.push(mistake(format!("the joint targets are in the order {name}"), targets));
        all.push(mistake(format!("readings and targets of the joints are in the order {name}"), move |row| {
            readings(row);
            targets(row);
        }));
    }
    let names = joint_names();
    let groups: [(&str, &[usize]); 5] = [
        ("all hips", &[0, 3, 6, 9]),
        ("all thighs", &[1, 4, 7, 10]),
        ("all calves", &[2, 5, 8, 11]),
        ("the right hips", &[0, 6]),
        ("the left hips", &[3, 9]),
    ];
    let single = names.iter().enumerate().map(|(joint, name)| (name.as_str(), vec![joint]));
    for (name, joints) in single.chain(groups.map(|(name, joints)| (name, joints.to_vec()))) {
        let of_readings = joints.clone();
        all.push(mistake(format!("angle and rate of {name} have the wrong sign"), move |row| {
            for joint in &of_readings {
                (row.q[*joint], row.dq[*joint], row.tau[*joint]) = (-row.q[*joint], -row.dq[*joint], -row.tau[*joint]);
            }
        }));
        let of_rates = joints.clone();
        all.push(mistake(format!("the rate of {name} has the wrong sign"), move |row| {
            of_rates.iter().for_each(|joint| row.dq[*joint] = -row.dq[*joint]);
        }));
        all.push(mistake(format!("the target of {name} has the wrong sign"), move |row| {
            joints.iter().for_each(|joint| row.target[*joint] = -row.target[*joint]);
        }));
    }
    let scaled = |values: &mut [f64], by: f64| values.iter_mut().for_each(|value| *value *= by);
    let degree = 1.0_f64.to_radians();
    all.push(mistake("joint angles are in degrees", move |row| scaled(&mut row.q, degree)));
    all.push(mistake("joint rates are in degrees per second", move |row| scaled(&mut row.dq, degree)));
    all.push(mistake("joint angles and rates are in degrees", move |row| {
        scaled(&mut row.q, degree);
        scaled(&mut row.dq, degree);
    }));
    all.push(mistake("joint targets are in degrees", move |row| scaled(&mut row.target, degree)));
    all.push(mistake("the gyro is in degrees per second", move |row| scaled(&mut row.gyro, degree)));
    all.push(mistake("the accelerometer is in g", move |row| scaled(&mut row.accelerometer, GRAVITY_M_S2)));
    let turns: [(&str, [f64; 3]); 4] = [
        ("forward, right, down instead of forward, left, up", [1.0, -1.0, -1.0]),
        ("backward, right, up: turned by half a turn", [-1.0, -1.0, 1.0]),
        ("a frame whose y axis is to the right", [1.0, -1.0, 1.0]),
        ("a frame whose x axis is to the rear", [-1.0, 1.0, 1.0]),
    ];
    for (name, signs) in turns {
        let turn = move |vector: &mut [f64; 3]| vector.iter_mut().zip(signs).for_each(|(value, sign)| *value *= sign);
        all.push(mistake(format!("gyro and accelerometer are in {name}"), move |row| {
            turn(&mut row.gyro);
            turn(&mut row.accelerometer);
        }));
        all.push(mistake(format!("the gyro is in {name}"), move |row| turn(&mut row.gyro)));
        all.push(mistake(format!("the accelerometer is in {name}"), move |row| turn(&mut row.accelerometer)));
    }
    let swap = |vector: &mut [f64; 3]| *vector = [vector[1], -vector[0], vector[2]];
    all.push(mistake("gyro and accelerometer have x to the left and y to the rear", move |row| {
        swap(&mut row.gyro);
        swap(&mut row.accelerometer);
    }));
    all.push(mistake("the accelerometer reads −g at rest: its sign is wrong", move |row| {
        scaled(&mut row.accelerometer, -1.0);
    }));
    all.push(mistake("the command's velocity to the left has the wrong sign", |row| row.command[1] = -row.command[1]));
    all.push(mistake("the command's yaw rate has the wrong sign", |row| row.command[2] = -row.command[2]));
    all
}
