//! Sensor data as other tools read them: [`point_cloud`] writes sweeps of LiDARs (KITTI, nuScenes,
//! PCD, PLY, NPY, Argoverse 2, MCAP), [`ros`] the ROS 2 messages of an episode.
#![forbid(unsafe_code)]

pub mod point_cloud;
pub mod ros;
