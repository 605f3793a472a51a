//! Connections as the gRPC server takes them.

use std::io::{IoSlice, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use decouplegs_connections::{
    Acceptor, Connection, ConnectionCounts, ConnectionInfo, ConnectionLimits,
};
use futures_util::Stream;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tonic::transport::server::Connected;

use crate::metrics::Metrics;
use crate::options::Limits;

/// Connections beyond the limit that are kept for health checks.
const HEALTH_CONNECTIONS: usize = 8;

/// A connection whose requests see its [`ConnectionInfo`].
pub struct Incoming(Connection);

/// Accepts connections from `listener` within `limits`, without an end; `closing` closes them all.
pub fn accept(
    listener: TcpListener,
    limits: &Limits,
    closing: watch::Receiver<bool>,
    metrics: Arc<Metrics>,
) -> impl Stream<Item = Result<Incoming>> + use<> {
    let limits = ConnectionLimits {
        connections: limits.connections as usize,
        address_connections: limits.address_connections,
        spare: HEALTH_CONNECTIONS,
        handshake: limits.handshake(),
        idle: limits.idle(),
    };
    let acceptor = Acceptor::new(listener, limits, closing, metrics);
    futures_util::stream::unfold(acceptor, |acceptor| async move {
        let connection = acceptor.accept().await;
        Some((Ok(Incoming(connection)), acceptor))
    })
}

impl ConnectionCounts for Metrics {
    fn opened(&self, more: i64) {
        self.connected(more);
    }

    fn refused(&self) {
        self.refused_connection();
    }
}

impl Connected for Incoming {
    type ConnectInfo = ConnectionInfo;

    fn connect_info(&self) -> ConnectionInfo {
        self.0.info()
    }
}

impl AsyncRead for Incoming {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        Pin::new(&mut self.0).poll_read(context, buffer)
    }
}

impl AsyncWrite for Incoming {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.0).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.0).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.0).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.0.is_write_vectored()
    }
}
