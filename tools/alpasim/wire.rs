//! The messages and services of the public contract, made from `proto/` when this package is built.

/// Messages that both services share.
pub mod common {
    #![allow(missing_docs, unused_qualifications, clippy::all)]
    tonic::include_proto!("common");
}

/// The ground service.
pub mod physics {
    #![allow(missing_docs, unused_qualifications, clippy::all)]
    tonic::include_proto!("physics");
}

/// The LiDAR service.
pub mod lidar {
    #![allow(missing_docs, unused_qualifications, clippy::all)]
    tonic::include_proto!("decouplegs");
}

/// The service of a driving policy.
pub mod egodriver {
    #![allow(missing_docs, unused_qualifications, clippy::all)]
    tonic::include_proto!("egodriver");
}

/// The package of the camera service, whose folders the generated code expects.
pub mod nre {
    /// `nre.grpc`.
    pub mod grpc {
        /// `nre.grpc.protos`.
        pub mod protos {
            /// The camera service.
            pub mod sensorsim {
                #![allow(missing_docs, unused_qualifications, clippy::all)]
                tonic::include_proto!("nre.grpc.protos.sensorsim");
            }
        }
    }
}

pub use nre::grpc::protos::sensorsim;
