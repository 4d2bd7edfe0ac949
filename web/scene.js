// Scenes as MJCF, as src/sim/scene.rs and src/scenario/catalog write them; the robot is in robot.xml.

const FRICTION = [0.8, 0.005, 0.0001];
const COLOURS = ["0.90 0.62 0.00 1", "0.34 0.71 0.91 1", "0.00 0.62 0.45 1", "0.80 0.47 0.65 1"];
const WOOD = 'density="650" priority="1" friction="0.5 0.005 0.0001"';
const WOODS = ["0.76 0.57 0.36 1", "0.66 0.47 0.28 1", "0.82 0.66 0.46 1"];

/** Fields of balls have so many rows, and half the columns of the scenario: two of them have to run in real time. */
const ROWS = 10;

/** Loose balls, of the parameters in configs/scenarios/ball-pit.yaml. */
function balls({ balls, mass_kg, radius_m, gap_m, distance_m }) {
  const columns = Math.ceil(Math.sqrt(balls)) / 2;
  const pitch = 2 * radius_m + gap_m;
  return Array.from({ length: ROWS * columns }, (_, ball) => {
    const [row, column] = [Math.floor(ball / columns), ball % columns];
    const place = [distance_m + (row + 0.5) * pitch, (column - 0.5 * (columns - 1)) * pitch, radius_m];
    return `<body pos="${place.join(" ")}"><joint type="free" damping="0.001"/><geom type="sphere" size="${radius_m}" mass="${mass_kg}"
      priority="1" friction="0.6 0.005 0.0001" rgba="${COLOURS[(row + 2 * column) % 4]}"/></body>`;
  }).join("\n");
}

/** Wooden blocks, of the sizes in configs/scenarios/rubble.yaml, in rows of this page's own. */
function blocks({ block_edge_m: edge, block_height_m: height, distance_m, width_m }) {
  const [rows, columns] = [5, 5];
  // Halves to wholes of the largest sizes, always the same.
  const random = (seed) => 0.75 + 0.25 * Math.sin(12.9898 * seed) ** 3;
  return Array.from({ length: rows * columns }, (_, block) => {
    const [row, column] = [Math.floor(block / columns), block % columns];
    const half = [edge, edge, height].map((most, axis) => 0.5 * most * random(3 * block + axis));
    const yaw = 0.5 * Math.PI * random(7 * block);
    const place = [distance_m + (row + 0.5) * 1.6 * edge, ((column + 0.5 + 0.3 * (row % 2)) / columns - 0.5) * 0.7 * width_m, half[2]];
    return `<body pos="${place.join(" ")}" quat="${Math.cos(yaw / 2)} 0 0 ${Math.sin(yaw / 2)}"><freejoint/><geom type="box"
      size="${half.join(" ")}" ${WOOD} rgba="${WOODS[block % 3]}"/></body>`;
  }).join("\n");
}

/** The scenes by name: obstacles from the parameters of their scenario, and attributes of the solver. */
export const SCENES = {
  flat: [() => "", ""],
  "ball pit": [(files) => balls(files.balls), 'solver="CG" iterations="20"'],
  blocks: [(files) => blocks(files.rubble), 'solver="CG" iterations="30"'],
};

/** The MJCF of a scene. `colliding` are the names of the robot's parts that touch the ground. */
export function sceneXml(name, files, colliding, timestep_s) {
  const [obstacles, solver] = [SCENES[name][0](files), SCENES[name][1]];
  const [sliding, torsional, rolling] = FRICTION;
  const friction = [sliding, sliding, torsional, rolling, rolling].join(" ");
  const pair = (part) => `<pair geom1="ground" geom2="${part}" condim="3" friction="${friction}"/>`;
  // A robot alone touches only the ground: its pairs are listed.
  const pairs = obstacles ? "" : `<option><flag island="disable"/></option><contact>${colliding.map(pair).join("")}</contact>`;
  return `<mujoco model="supple">
  <include file="robot.xml"/>
  <compiler discardvisual="true"/>
  <option timestep="${timestep_s}" integrator="Euler" cone="pyramidal" ${solver}/>
  ${pairs}
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" condim="3" priority="1" friction="${FRICTION.join(" ")}"/>
    ${obstacles}
  </worldbody>
</mujoco>`;
}

export const ALONE = '<mujoco><include file="robot.xml"/><compiler discardvisual="true"/></mujoco>';
export const LOOKS = '<mujoco><include file="robot.xml"/></mujoco>';
