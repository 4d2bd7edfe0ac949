//! The look of scenes in pictures: a sky, a sun whose shadows are sharp around the robot, and a chequered ground.
//!
//! Models for simulation have none of these. Lengths are metres, as the extent of the scene is set to 1 m.

/// Name of the material of the ground.
pub(super) const GROUND_MATERIAL: &str = "supple_ground";

/// MJCF elements outside the world body.
pub(super) const SETTINGS: &str = r#"  <statistic extent="1" center="0 0 0.2"/>
  <visual>
    <global fovy="40"/>
    <headlight ambient="0.42 0.42 0.42" diffuse="0.22 0.22 0.22" specular="0.05 0.05 0.05"/>
    <map znear="0.02" zfar="40" shadowclip="2.5" fogstart="4" fogend="16" haze="0.3"/>
    <quality shadowsize="2048" offsamples="4" numslices="16" numstacks="10"/>
    <rgba fog="0.93 0.95 0.97 1" haze="0.93 0.95 0.97 1"/>
  </visual>
  <asset>
    <texture name="supple_sky" type="skybox" builtin="gradient" rgb1="0.93 0.95 0.97" rgb2="0.62 0.72 0.83" width="64" height="384"/>
    <texture name="supple_ground" type="2d" builtin="checker" rgb1="0.70 0.73 0.76" rgb2="0.80 0.83 0.86" width="256" height="256"/>
    <material name="supple_ground" texture="supple_ground" texuniform="true" texrepeat="2 2" specular="0.1" shininess="0.1"/>
  </asset>
"#;

/// MJCF elements of the world body.
pub(super) const SUN: &str = r#"    <light name="supple_sun" directional="true" castshadow="true" pos="0 0 3" dir="-0.35 0.45 -1" diffuse="0.62 0.62 0.6" specular="0.25 0.25 0.25"/>
"#;
