//! How a server is told to end: one signal asks, a second one does not wait.

use std::future::Future;

use anyhow::Context;
use tokio::sync::oneshot;

/// The exit code of a process that a second signal ended: what a shell gives for Ctrl-C.
pub const ENDED_AT_ONCE: i32 = 130;

/// Ready when the process is asked to end: Ctrl-C, or SIGTERM where there is such a thing. Listens from the call on. A second
/// one ends the process at once with [`ENDED_AT_ONCE`], after `last`. A thread of its own waits for it, so that a server that
/// hangs can be ended too.
///
/// # Errors
/// If the system does not let us listen for signals.
pub fn signals(last: impl FnOnce() + Send + 'static) -> anyhow::Result<impl Future<Output = ()>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut asked = {
        let _entered = runtime.enter();
        Asked::listen()?
    };
    let (first, told) = oneshot::channel();
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            runtime.block_on(async {
                asked.again().await;
                // If nobody waits for it, the server has ended already.
                let _ = first.send(());
                asked.again().await;
                last();
                tracing::warn!("told to end twice: ending at once");
                std::process::exit(ENDED_AT_ONCE);
            });
        })
        .context("cannot start the thread that waits for signals")?;
    Ok(async {
        if told.await.is_err() {
            // The thread has gone: then nobody will ask.
            std::future::pending::<()>().await;
        }
    })
}

/// The signals that ask a process to end.
struct Asked {
    #[cfg(unix)]
    interrupt: tokio::signal::unix::Signal,
    #[cfg(unix)]
    terminate: tokio::signal::unix::Signal,
}

impl Asked {
    fn listen() -> anyhow::Result<Asked> {
        #[cfg(unix)]
        {
            use tokio::signal::unix::{SignalKind, signal};
            let interrupt = signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?;
            let terminate = signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?;
            Ok(Asked { interrupt, terminate })
        }
        #[cfg(not(unix))]
        Ok(Asked {})
    }

    async fn again(&mut self) {
        #[cfg(unix)]
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
        #[cfg(not(unix))]
        let _ = tokio::signal::ctrl_c().await;
    }
}

/// Ready when the process is asked to end, for programs that have nothing to drain. Listens from the call on.
///
/// # Errors
/// If the system does not let us listen for signals.
pub fn signal() -> anyhow::Result<impl Future<Output = ()>> {
    let mut asked = Asked::listen()?;
    Ok(async move { asked.again().await })
}
